# SPDX-License-Identifier: Apache-2.0
"""How well a physics engine knows where a tip touches: its geometries and ours, beside formulas.

    PYTHONPATH=. python benchmarks/contact_geometry.py

For each object of the catalogue, and each way to tell MuJoCo of its surface: how far the contact
of a 4.5 µm tip is from the formula's at 400 places along both sections, in position and in
direction, and how a roll of 180° between the joints goes.
"""

from __future__ import annotations

import time
from typing import Any
from unittest.mock import patch

import mujoco
import numpy as np
from record import write

from microhand_planner.core.catalogue import find_part
from microhand_planner.core.parameters import Finger
from microhand_planner.core.part import Part
from microhand_planner.core.section_curves import section_curves
from microhand_twin import world as twin_world
from microhand_twin.numerics import LENGTH_UNIT_UM
from microhand_twin.simulation import Simulation
from microhand_twin.surface_collision import smooth_contacts
from microhand_twin.world import World, build_world
from tests.twin.rolls import along_curve, roll
from tests.twin.test_smooth_surface import FORMULAS, points_of_formula

RADIUS_UM = 4.5
PRESS_UM = 0.03
"""Deeper than facets lie below the surface, so that they are met at all."""
SLABS = 292
AROUND = 96

COLLIDES = 'contype="2" conaffinity="1"'
GEOMS = {
    'facets': f'<geom name="object" type="mesh" mesh="object" {COLLIDES}/>',
    'SDF of the mesh': f'<geom name="object" type="sdf" mesh="object" {COLLIDES}/>',
}


def worlds(part: Part) -> dict[str, World]:
    """Return the worlds of a part, by how MuJoCo is told of it."""
    found = {}
    if part.name == 'ellipsoid':
        found["MuJoCo's ellipsoid"] = build_world(part)
    with patch.object(twin_world, 'ellipsoid_of', lambda part: None):
        for name, geom in GEOMS.items():
            if name == 'facets' and part.name == 'concave':
                continue  # MuJoCo takes the convex hull of a mesh
            with patch.object(twin_world, '_carrier_xml', lambda part, geom=geom: geom):
                found[name] = build_world(part)
        if part.name == 'concave':
            found[f'{SLABS} convex slabs'] = in_slabs(part)
        found['smooth patches'] = build_world(part)
    return found


def in_slabs(part: Part) -> World:
    """Return a world in which the concave object is cut into thin convex slabs."""
    a, waist, flare, h = FORMULAS[part.name]
    levels = np.cos(np.linspace(0.0, np.pi, SLABS + 1))
    angle = np.arange(AROUND) * 2.0 * np.pi / AROUND
    rings = []
    for x in levels:
        wide = np.sqrt(max(0.0, 1.0 - x**2))
        ring = np.column_stack([
            np.full(AROUND, a * x),
            (waist + flare * x**2) * wide * np.cos(angle),
            h * wide * np.sin(angle),
        ])  # fmt: skip
        rings.append(ring / LENGTH_UNIT_UM)
    geoms = ''.join(
        f'<geom type="mesh" mesh="slab{i}" {COLLIDES}/>' for i in range(SLABS)
    )  # fmt: skip
    original = mujoco.MjSpec.from_string

    def with_slabs(xml: str) -> Any:
        spec = original(xml)
        for i in range(SLABS):
            points = np.vstack([rings[i], rings[i + 1]])
            spec.add_mesh(name=f'slab{i}', uservert=points.ravel())
        return spec

    with (
        patch.object(twin_world, '_carrier_xml', lambda part: geoms),
        patch.object(twin_world.mujoco.MjSpec, 'from_string', with_slabs),
    ):
        return build_world(part)


def contact_errors(world: World, name: str) -> dict[str, float]:
    """Return errors of contacts at places of the formula."""
    points_um, normals = points_of_formula(name, 400, seed=4)
    data = mujoco.MjData(world.model)
    distance_nm, direction_deg, missed = [], [], 0
    began_s = time.perf_counter()
    for point_um, normal in zip(points_um, normals, strict=True):
        centre_um = point_um + (RADIUS_UM - PRESS_UM) * normal
        data.qpos[:7] = [0, 0, 0, 1, 0, 0, 0]
        data.qpos[7:] = [*(centre_um / LENGTH_UNIT_UM), 100, 0, 0, 0, 100, 0]
        with smooth_contacts(world.smooth):
            mujoco.mj_fwdPosition(world.model, data)
        if not len(data.contact.dist):
            missed += 1
            continue
        nearest = int(np.argmin(data.contact.dist))
        found = data.contact.frame[nearest][:3]
        distance_nm.append(1e3 * (data.contact.dist[nearest] * LENGTH_UNIT_UM + PRESS_UM))
        turn = np.linalg.norm(np.cross(found, normal))
        direction_deg.append(np.degrees(np.arcsin(min(1.0, turn))))
    return {
        'missed': missed,
        'distance_median_nm': float(np.median(np.abs(distance_nm))),
        'distance_worst_nm': float(np.max(np.abs(distance_nm))),
        'direction_median_deg': float(np.median(direction_deg)),
        'direction_worst_deg': float(np.max(direction_deg)),
        'place_us': 1e6 * (time.perf_counter() - began_s) / len(points_um),
    }


def roll_errors(world: World, name: str) -> dict[str, float]:
    """Return how half a turn about Z between the joints goes, on springs of 100 N/m."""
    curve = section_curves(find_part(name), Finger()).curves['z']
    contacts = along_curve(curve, (0.0, curve.phase_of_joint_j))
    began_s = time.perf_counter()
    rolled = roll(Simulation(world), contacts, curve.plane.normal, 180.0, 1.5)
    jump_uN = np.abs(np.diff(rolled.normal_uN, axis=0)).max()
    return {
        'roll_worst_deg': float(rolled.error_deg.max()),
        'roll_end_deg': float(rolled.error_deg[-1]),
        'force_jump_uN': float(jump_uN),
        'force_spread_uN': float(np.ptp(rolled.normal_uN)),
        'roll_wall_s': time.perf_counter() - began_s,
    }


def main() -> None:
    """Measure, print a line each, and write the results."""
    rows = []
    for name in FORMULAS:
        for kind, world in worlds(find_part(name)).items():
            row = {
                'object': name, 'surface': kind,
                **contact_errors(world, name), **roll_errors(world, name),
            }  # fmt: skip
            rows.append(row)
            print(
                f'{name:9} {kind:19} missed {row["missed"]:3}, '
                f'{row["distance_median_nm"]:8.3g} nm (worst {row["distance_worst_nm"]:8.3g}), '
                f'{row["direction_median_deg"]:7.2g}° (worst {row["direction_worst_deg"]:7.2g}); '
                f'180°: {row["roll_end_deg"]:6.2g}° off, at worst {row["roll_worst_deg"]:6.2g}°, '
                f'force jumps by {row["force_jump_uN"]:6.2g} µN, in {row["roll_wall_s"]:.1f} s',
                flush=True,
            )
    print(write('contact_geometry', rows, ('mujoco', 'numpy', 'scipy', 'numba')))


if __name__ == '__main__':
    main()
