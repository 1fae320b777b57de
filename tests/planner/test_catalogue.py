# SPDX-License-Identifier: Apache-2.0
"""Objects by name: what is built in is what the paper needs, and unknown names say what exists."""

import json
import math
import runpy
from pathlib import Path

import numpy as np
import pytest
import trimesh

from microhand_planner.core.analytic_sections import waisted_section
from microhand_planner.core.catalogue import BUILT_IN, find_part, list_objects
from microhand_planner.core.cut_section import cut_section
from microhand_planner.core.errors import InvalidMesh, InvalidParameter, UnknownObject
from microhand_planner.core.joints import check_joints
from microhand_planner.core.offset_curve import offset_curve
from microhand_planner.core.parameters import Finger
from microhand_planner.core.section import XY_PLANE, XZ_PLANE

EXAMPLES = Path(__file__).parents[2] / 'examples'
SHAPES = {  # a, waist and flare of XY, half height of XZ; fewest and most contacts on XY, on XZ
    'ellipsoid': (16.2, 11.6, 0.0, 11.6, (73.5, 74.5), (73.5, 74.5)),
    'convex': (36.5, 30.5, 4.0, 29.3, (150.0, 156.0), (149.0, 151.0)),
    'concave': (36.5, 16.0, 76.0, 29.3, (212.0, 228.0), (149.0, 151.0)),
}


@pytest.fixture(scope='module', params=SHAPES)
def name(request):
    """Return the name of each built-in object in turn."""
    return request.param


def test_built_in_objects_are_listed():
    """The three objects of the paper, with what a user wants to know."""
    entries = list_objects()
    assert [entry.name for entry in entries] == sorted(SHAPES)
    for entry in entries:
        assert entry.mesh_file.stat().st_size < 1_000_000
        assert entry.unit_um == 1.0
        assert 'µm' in entry.description


def test_built_in_objects_have_the_contacts_of_the_paper(name):
    """Mesh and formula agree: contacts per section, places within 4 nm, normals within 0.05°."""
    a, waist, flare, height, contacts_xy, contacts_xz = SHAPES[name]
    part = find_part(name)
    assert len(part.faces) >= 5120
    curves = []
    for plane, exact, contacts in (
        (XY_PLANE, waisted_section(a, waist, flare, XY_PLANE), contacts_xy),
        (XZ_PLANE, waisted_section(a, height, 0.0, XZ_PLANE), contacts_xz),
    ):
        curve = offset_curve(cut_section(part, plane), 4.5, part)
        wanted = offset_curve(exact, 4.5)
        assert contacts[0] <= curve.length_rad / math.radians(20.0) <= contacts[1]
        assert curve.length_rad == pytest.approx(wanted.length_rad, abs=3e-4)
        assert curve.inadmissible_share == 0.0
        assert len(curve.kinks_rad) == 0
        share = np.linspace(0.0, 1.0, 4000)
        got, true = curve.at(share * curve.length_rad), wanted.at(share * wanted.length_rad)
        assert np.linalg.norm(got.contact_um - true.contact_um, axis=1).max() < 0.004
        cosine = np.clip((got.normal * true.normal).sum(axis=1), -1.0, 1.0)
        assert math.degrees(np.arccos(cosine).max()) < 0.05
        curves.append(curve)
    check_joints(*curves, Finger())


def test_convex_and_concave_object_share_their_second_section():
    """Both have the same section XZ, as in the paper's Table 2."""
    turns = [
        offset_curve(cut_section(find_part(name), XZ_PLANE), 4.5).length_rad
        for name in ('convex', 'concave')
    ]
    assert turns[0] == pytest.approx(turns[1], abs=1e-4)


def test_examples_are_the_built_in_objects(name, tmp_path):
    """The links in examples/ lead to the meshes, and the script makes them byte for byte."""
    script = runpy.run_path(str(EXAMPLES / 'make_parts.py'))
    script['main'](tmp_path)
    for suffix in ('stl', 'json'):
        built_in = (BUILT_IN / f'{name}.{suffix}').read_bytes()
        assert (EXAMPLES / f'{name}.{suffix}').read_bytes() == built_in
        assert (tmp_path / f'{name}.{suffix}').read_bytes() == built_in


def test_part_by_path_equals_part_by_name(name):
    """A name and the path of its mesh give the same part."""
    by_path = find_part(str(EXAMPLES / f'{name}.stl'))
    assert by_path.name == name
    assert by_path.sha256 == find_part(name).sha256


def test_unknown_name_lists_what_exists():
    """The message names all objects and formats."""
    with pytest.raises(UnknownObject, match=r'concave, convex, ellipsoid.*\.stl') as caught:
        find_part('sphere')
    assert caught.value.exit_status == 2


def test_unit_of_the_catalogue_can_be_overruled():
    """A unit in the request wins; a wrong one is found out."""
    np.testing.assert_allclose(find_part('ellipsoid', unit_um=0.5).extents_um[0], 16.2)
    with pytest.raises(InvalidMesh, match='unit'):
        find_part('ellipsoid', unit_um=1e6)


def _write_entry(folder, **changes):
    sidecar = {'mesh': 'box.off', 'unit_um': 2.0, 'frame': 'principal_axes', 'description': 'Box'}
    (folder / 'box.json').write_text(json.dumps({**sidecar, **changes}))
    trimesh.creation.box(extents=[5.0, 10.0, 20.0]).export(folder / 'box.off')


def test_own_catalogue(tmp_path):
    """Unit and frame of the sidecar are used."""
    _write_entry(tmp_path)
    assert [entry.name for entry in list_objects(tmp_path)] == ['box']
    part = find_part('box', folder=tmp_path)
    np.testing.assert_allclose(part.extents_um, [40.0, 20.0, 10.0])


@pytest.mark.parametrize(
    'changes',
    [{'unit_um': 0}, {'unit_um': 'two'}, {'frame': 'mine'}, {'mesh': None}, {'unit_um': None}],
)
def test_damaged_entry_is_named(tmp_path, changes):
    """A wrong value in a sidecar is a bad request that names the entry."""
    _write_entry(tmp_path, **changes)
    with pytest.raises(InvalidParameter, match='box'):
        find_part('box', folder=tmp_path)


def test_damaged_json_is_named(tmp_path):
    """A sidecar that is no JSON object is a bad request that names the file."""
    (tmp_path / 'odd.json').write_text('[1, 2')
    with pytest.raises(InvalidParameter, match=r'odd\.json'):
        list_objects(tmp_path)
