# SPDX-License-Identifier: Apache-2.0
"""One planar rotation made discrete: where fingers may stand, and at which angles they may change.

A finger that rolls keeps ``a = x + θ`` (contact phase + object angle): its *track*. So the whole
problem is a set of tracks, a set of orientations, and the contact phase ``x = a - θ`` wherever a
track meets an orientation. Phases are looked up exactly: nothing is rounded to a neighbour.

In robust mode the step is fitted to the part, ``T / ceil(T / Δθ)``, so that tracks started from
joint I stay on one lattice of phases for ever; joint J, an arbitrary goal angle and a given start
grasp bring tracks of their own. In paper mode ([Kumar2021] §3.3) contacts and angles are the
multiples of Δθ and joint J is the contact nearest to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba as nb
import numpy as np
import numpy.typing as npt

from microhand_planner.core.errors import InvalidParameter
from microhand_planner.core.offset_curve import OffsetCurve
from microhand_planner.core.parameters import Mode, SearchOptions
from microhand_planner.core.pose import FloatArray

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

_FULL_TURN = 2.0 * math.pi
_SAME = 1e-9  # two tracks or angles closer than this share of a step are one
_MOST_CONTACTS = 100_000
_MOST_ENTRIES = 1 << 25  # contacts times orientations: `sample_of` takes a quarter of a gigabyte
_LARGEST_GAP_RAD = math.radians(2.0)  # between two samples at which a roll is checked
_NANODEGREES = 1e9


@dataclass(frozen=True)
class RotationLattice:
    """Tracks, orientations and contact samples of one planar rotation.

    Parameters
    ----------
    contacts : int
        Contact points on the lattice in one turn, the paper's c.
    spacing_rad : float
        Phase between two of them [rad].
    theta_rad : (m,) float
        Orientations at which fingers may change, ascending [rad].
    theta_ndeg : (m,) int
        The same in nanodegrees: costs are integers, so that equal costs are equal.
    start, goal : int
        Indices of the first and the last orientation of the rotation.
    track_unit : (n,) float
        Tracks, in units of the lattice.
    sample_of : (n, m) int
        Contact sample of a track at an orientation.
    interior : (m - 1,) int
        Samples strictly between an orientation and the next, at which a roll is checked.
    block : int
        Samples per block; within a block indices are periodic, and rolling forward counts down.
    phase_rad : (s,) float
        Phase of each sample [rad].
    centre_um, contact_um, normal : (s, 2) float
        Tip centre, contact and outward normal of each sample; object frame in the plane.
    phase_per_angle : float
        Phase that a finger rolls through per angle of the object: 1, but for the paper's lattice
        on a section whose turn is no multiple of the step.
    usable : (s,) bool
        False: no finger may stand there.
    """

    contacts: int
    spacing_rad: float
    theta_rad: FloatArray
    theta_ndeg: IntArray
    start: int
    goal: int
    track_unit: FloatArray
    sample_of: IntArray
    interior: IntArray
    block: int
    phase_rad: FloatArray
    centre_um: FloatArray
    contact_um: FloatArray
    normal: FloatArray
    phase_per_angle: float
    usable: BoolArray

    def __post_init__(self) -> None:
        """Freeze the arrays, rows one after the other."""
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if isinstance(value, np.ndarray):
                value = np.ascontiguousarray(value)  # the searches are compiled for one layout
                value.setflags(write=False)
                object.__setattr__(self, name, value)

    def track_at(self, phase_rad: float, orientation: int) -> int:
        """Return the track whose contact phase is nearest to `phase_rad` at an orientation."""
        turn_rad = self.contacts * self.spacing_rad
        phases = self.phase_rad[self.sample_of[:, orientation]]
        gap = (phases - phase_rad + 0.5 * turn_rad) % turn_rad - 0.5 * turn_rad
        return int(np.argmin(np.abs(gap)))


def rotation_lattice(
    curve: OffsetCurve,
    angle_rad: float,
    options: SearchOptions,
    start_phase_rad: tuple[float, ...] = (),
    goal_phase_rad: tuple[float, ...] = (),
    interrupt: IntArray | None = None,
) -> RotationLattice:
    """Make one planar rotation discrete.

    Parameters
    ----------
    curve : OffsetCurve
        Path of the tip's centre around the section.
    angle_rad : float
        Rotation of the object, within one turn either way [rad].
    options : SearchOptions
        Step and mode.
    start_phase_rad, goal_phase_rad : tuple of float
        Contact phases that fingers have at the start, or must have at the goal [rad].
    interrupt : (2,) int64, optional
        See `interruption`; what is returned then is good for nothing.

    Returns
    -------
    RotationLattice

    Raises
    ------
    InvalidParameter
        In paper mode, an angle that is no multiple of the step; a step so small that there are
        more contacts and orientations than fit into memory.
    """
    paper = options.mode is Mode.PAPER
    exact = curve.length_rad / options.step_rad
    contacts = round(exact) if paper else math.ceil(exact - _SAME)
    _check_size(curve, contacts, options)
    spacing_rad = curve.length_rad / contacts
    step_rad = options.step_rad if paper else spacing_rad

    angle_unit = angle_rad / step_rad
    if paper and abs(angle_unit - round(angle_unit)) > 1e-6:
        raise InvalidParameter(
            'angle',
            f'{math.degrees(angle_rad):g} deg',
            f'in paper mode a multiple of step-deg ({math.degrees(options.step_rad):g}); '
            'robust mode takes any angle',
        )
    snap = round if paper else float
    start_unit = [float(snap(phase / spacing_rad)) for phase in start_phase_rad]
    goal_unit = [float(snap(phase / spacing_rad)) for phase in goal_phase_rad]
    theta_unit, goal = _orientations(snap(angle_unit), _FULL_TURN / step_rad, one_sided=paper)
    track_unit = _distinct(
        np.concatenate([np.arange(contacts), start_unit, np.array(goal_unit) + theta_unit[goal]]),
        contacts,
    )

    gap_rad = spacing_rad if paper else _LARGEST_GAP_RAD
    density = max(1, math.ceil(spacing_rad / gap_rad - _SAME))
    if interrupt is None:
        interrupt = np.zeros(2, dtype=np.int64)
    sample_of, phase_unit = _contact_samples(track_unit, theta_unit, contacts, density, interrupt)
    phase_rad = phase_unit * spacing_rad
    points = curve.at(phase_rad)
    margin_rad = 0.0 if paper else spacing_rad / density
    return RotationLattice(
        contacts=contacts,
        spacing_rad=spacing_rad,
        theta_rad=theta_unit * step_rad,
        theta_ndeg=np.round(np.degrees(theta_unit * step_rad) * _NANODEGREES).astype(np.int64),
        start=int(np.flatnonzero(theta_unit == 0.0)[0]),
        goal=goal,
        track_unit=track_unit,
        sample_of=sample_of,
        interior=np.ceil(np.diff(theta_unit) * density - 1e-6).astype(np.int64) - 1,
        block=contacts * density,
        phase_rad=phase_rad,
        centre_um=points.centre_um.copy(),
        contact_um=points.contact_um.copy(),
        normal=points.normal.copy(),
        phase_per_angle=spacing_rad / step_rad,
        # nobody stands within one sample of a kink or a blocked phase: so no roll crosses one
        usable=curve.rolls_freely(phase_rad - margin_rad, phase_rad + margin_rad),
    )


def _check_size(curve: OffsetCurve, contacts: int, options: SearchOptions) -> None:
    """Refuse a lattice that is too large."""
    turns = 1.0 if options.mode is Mode.PAPER else 2.0
    orientations = turns * _FULL_TURN / options.step_rad
    if contacts > _MOST_CONTACTS or contacts * orientations > _MOST_ENTRIES:
        least_rad = max(
            curve.length_rad / _MOST_CONTACTS,
            math.sqrt(curve.length_rad * turns * _FULL_TURN / _MOST_ENTRIES),
        )
        raise InvalidParameter(
            'step-deg',
            f'{math.degrees(options.step_rad):g}',
            f'for this section and finger-radius a number >= {math.degrees(least_rad):.2g}: this '
            f'step makes {contacts} contacts and {orientations:.0f} orientations',
        )


def _orientations(
    angle_unit: float, turn_unit: float, *, one_sided: bool
) -> tuple[FloatArray, int]:
    """Return the orientations within one turn, in steps from the start, and the goal's index."""
    most = math.floor(turn_unit + _SAME)
    low = 0 if one_sided and angle_unit >= 0 else -most
    high = 0 if one_sided and angle_unit < 0 else most
    theta = np.arange(low, high + 1, dtype=np.float64)
    nearest = int(np.argmin(np.abs(theta - angle_unit)))
    if abs(theta[nearest] - angle_unit) > _SAME:
        theta = np.sort(np.append(theta, angle_unit))
        nearest = int(np.searchsorted(theta, angle_unit))
    return theta, nearest


def _distinct(track_unit: FloatArray, contacts: int) -> FloatArray:
    """Return the tracks modulo one turn, in order, without those that are there already."""
    kept: list[float] = list(track_unit[:contacts])
    for track in track_unit[contacts:] % contacts:
        gap = (np.array(kept) - track + 0.5 * contacts) % contacts - 0.5 * contacts
        if np.min(np.abs(gap)) > _SAME:
            kept.append(float(track))
    return np.array(kept)


def _contact_samples(
    track_unit: FloatArray,
    theta_unit: FloatArray,
    contacts: int,
    density: int,
    interrupt: IntArray,
) -> tuple[IntArray, FloatArray]:
    """Return the sample of each track at each orientation, and the samples' phases.

    Tracks on the lattice share one block of samples; each other shift against the lattice brings
    a block of its own, `density` samples per lattice unit.
    """
    # only the goal may lie off the lattice of orientations: few of their fractions differ
    whole_turn = np.floor(theta_unit)
    fraction, kind = np.unique(theta_unit - whole_turn, return_inverse=True)
    phase = track_unit[:, None] - fraction[None, :]
    whole = np.floor(phase + _SAME)
    shift = np.maximum(phase - whole, 0.0)
    _, first, block = np.unique(np.round(shift / _SAME), return_index=True, return_inverse=True)
    shifts = shift.ravel()[first]
    sample_of = np.zeros((len(track_unit), len(theta_unit)), dtype=np.int64)
    _fill_samples(
        sample_of,
        whole.astype(np.int64),
        block.reshape(phase.shape) * contacts,
        kind,
        whole_turn.astype(np.int64) % contacts,
        contacts,
        density,
        interrupt,
    )
    steps = np.arange(contacts * density) / density
    return sample_of, (shifts[:, None] + steps[None, :]).ravel()


@nb.njit(cache=True, nogil=True)
def _fill_samples(
    sample_of: IntArray,
    whole: IntArray,
    block: IntArray,
    kind: IntArray,
    turned: IntArray,
    contacts: int,
    density: int,
    interrupt: IntArray,
) -> None:  # pragma: no cover - compiled
    """Fill the samples of all tracks, one after the other, unless interrupted.

    Parameters
    ----------
    sample_of : (n, m) int
        Takes the samples.
    whole, block : (n, k) int
        By kind of orientation: lattice units that a track lies behind, and where its block begins.
    kind, turned : (m,) int
        Kind of an orientation, and by how many lattice units it is turned, modulo one turn.
    contacts, density, interrupt
        As in `rotation_lattice`.
    """
    for track in range(len(sample_of)):
        if interrupt[0] != 0:
            return
        for at in range(len(kind)):
            unit = whole[track, kind[at]] - turned[at]
            if unit < 0:
                unit += contacts
            sample_of[track, at] = (block[track, kind[at]] + unit) * density
