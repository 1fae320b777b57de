# SPDX-License-Identifier: Apache-2.0
"""Independent answers for the planner's tests, written from the paper without the planner's code.

Contacts on an ellipse come from elliptic integrals, removals from linear programs (HiGHS) or from
the null space of the grasp matrix, and stability from a theorem of the alternative.
"""

import itertools
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import linprog
from scipy.special import ellipeinc


def planar_cross(first, second):
    """Return the z component of the cross product of planar vectors (..., 2)."""
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]


@dataclass(frozen=True)
class Ellipse:
    """Contacts of a tip that runs around an ellipse, by phase = length of its way / its radius."""

    a_um: float
    b_um: float
    tip_um: float

    def phase(self, t):
        """Return the phase of the contact (a cos t, b sin t)."""
        arc_um = self.b_um * ellipeinc(t, 1.0 - (self.a_um / self.b_um) ** 2)
        sin, cos = np.sin(t), np.cos(t)
        ahead = (self.a_um - self.b_um) * sin * cos
        normal_angle = t + np.arctan2(ahead, self.b_um * cos**2 + self.a_um * sin**2)
        return arc_um / self.tip_um + normal_angle

    @property
    def turn_rad(self):
        """Phase of one turn, T."""
        return float(self.phase(2 * math.pi))

    @cached_property
    def table(self):
        """Phases at equidistant t, where the search for a t begins."""
        t = np.linspace(0.0, 2 * math.pi, 721)
        return t, self.phase(t)

    def at(self, phase_rad):
        """Return contacts, outward normals and tip centres, (..., 2) each; by Newton's method."""
        wanted = np.asarray(phase_rad, dtype=float) % self.turn_rad
        t = np.interp(wanted, self.table[1], self.table[0])
        for _ in range(4):
            sin, cos = np.sin(t), np.cos(t)
            along = np.hypot(self.a_um * sin, self.b_um * cos) / self.tip_um
            turning = self.a_um * self.b_um / ((self.b_um * cos) ** 2 + (self.a_um * sin) ** 2)
            t -= (self.phase(t) - wanted) / (along + turning)
        sin, cos = np.sin(t), np.cos(t)
        contact = np.stack([self.a_um * cos, self.b_um * sin], axis=-1)
        normal = np.stack([self.b_um * cos, self.a_um * sin], axis=-1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        return contact, normal, contact + self.tip_um * normal


def nearest_on_ellipsoid_um(points_um, semi_axes_um):
    """Return the nearest points of an ellipsoid to points (..., 3) outside.

    The nearest point is q with p - q = s (q / axes^2); s >= 0 follows by bisection.
    """
    points_um = np.asarray(points_um)
    squares = np.square(semi_axes_um)
    low = np.zeros(points_um.shape[:-1])
    high = np.max(semi_axes_um) * np.linalg.norm(points_um, axis=-1)
    for _ in range(70):
        s = 0.5 * (low + high)
        nearest = points_um * squares / (squares + s[..., None])
        outside = np.sum(nearest**2 / squares, axis=-1) > 1.0
        low, high = np.where(outside, s, low), np.where(outside, high, s)
    return nearest


def distance_to_ellipsoid_um(points_um, semi_axes_um):
    """Return the distance of points (..., 3) outside an ellipsoid from it."""
    nearest = nearest_on_ellipsoid_um(points_um, semi_axes_um)
    return np.linalg.norm(points_um - nearest, axis=-1)


# ---------------------------------------------------------------- linear programs


def grasp_rows(contact_um, normal):
    """Return the wrench (force, moment) of unit forces f_n, f_t at each contact, (3, 2 k)."""
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=-1)
    columns = []
    for at, inward, along in zip(contact_um, -normal, tangent, strict=True):
        columns += [[*force, planar_cross(at, force)] for force in (inward, along)]
    return np.array(columns).T


def coulomb_rows(fingers, friction, pull_off_uN):
    """Return (A, b) with A f <= b for |f_t| <= friction (f_n + pull_off)."""
    rows = []
    for finger, sign in itertools.product(range(fingers), (1.0, -1.0)):
        row = np.zeros(2 * fingers)
        row[2 * finger : 2 * finger + 2] = -friction, sign
        rows.append(row)
    return np.array(rows), np.full(2 * fingers, friction * pull_off_uN)


def removal_window_lp(stay_um, stay_normal, leave_um, leave_normal, law):
    """Return the least and the largest grip force of [Kumar2021] Eq. 4, or None if there is none.

    The grip force is half of what the two forces press against each other along their line.
    """
    stay_um, stay_normal = np.asarray(stay_um), np.asarray(stay_normal)
    line = stay_um[1] - stay_um[0]
    line = line / np.linalg.norm(line)
    tangent = np.stack([-stay_normal[:, 1], stay_normal[:, 0]], axis=-1)
    grip = 0.5 * np.array(
        [-stay_normal[0] @ line, tangent[0] @ line, stay_normal[1] @ line, -tangent[1] @ line]
    )
    pull = law.pull_off_uN * np.asarray(leave_normal)
    cone, limit = coulomb_rows(2, law.friction, law.pull_off_uN)
    window = []
    for sign in (1.0, -1.0):
        answer = linprog(
            sign * grip,
            A_ub=cone,
            b_ub=limit,
            A_eq=grasp_rows(stay_um, stay_normal),
            b_eq=[*-pull, -planar_cross(np.asarray(leave_um), pull)],
            bounds=[(0.0, law.max_force_uN), (None, None)] * 2,
            method='highs',
        )
        if answer.status == 2:
            return None
        assert answer.status == 0, answer.message
        window.append(sign * answer.fun)
    return tuple(window)


def least_energy_answer(contact_um, load):
    """Return the forces (k, 2) that balance a planar load (f_x, f_y, moment) with least energy.

    Of all forces in balance, equal springs make those whose sum of squares is least (the theorem
    of least complementary energy).
    """
    contact_um = np.asarray(contact_um, dtype=float)
    k = len(contact_um)
    rows = np.zeros((3, 2 * k))
    rows[0, 0::2] = rows[1, 1::2] = 1.0
    rows[2, 0::2], rows[2, 1::2] = -contact_um[:, 1], contact_um[:, 0]
    # moments about the middle of the contacts, so that all rows are of one size
    middle = contact_um.mean(axis=0)
    size = np.max(np.abs(contact_um - middle))
    shift = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [middle[1], -middle[0], 1.0]])
    scale = np.array([1.0, 1.0, 1.0 / size])
    rows, load = scale[:, None] * (shift @ rows), scale * (shift @ load)
    return np.linalg.lstsq(rows, -load, rcond=None)[0].reshape(k, 2)


def preload_program(stay_um, stay_normal, leave_um, leave_normal, law, friction):
    """Return a function that optimises over the grips before and while a finger pulls.

    Unknown are the four force components before the pull, which are in balance, and the margin
    m that they, and they with the answer of the springs, keep to slipping, detaching and
    overload. The function takes the weights of grip and margin and the bounds of the margin, and
    returns the answer of HiGHS.
    """
    stay_um, stay_normal = np.asarray(stay_um), np.asarray(stay_normal)
    line = stay_um[1] - stay_um[0]
    line = line / np.linalg.norm(line)
    tangent = np.stack([-stay_normal[:, 1], stay_normal[:, 0]], axis=-1)
    grip = 0.5 * np.array(
        [-stay_normal[0] @ line, tangent[0] @ line, stay_normal[1] @ line, -tangent[1] @ line]
    )
    pull = law.pull_off_uN * np.asarray(leave_normal)
    answer = least_energy_answer(stay_um, [*pull, planar_cross(np.asarray(leave_um), pull)])
    rows, limits = [], []
    for finger, share in itertools.product(range(2), (0.0, 1.0)):
        normal_uN = -share * answer[finger] @ stay_normal[finger]
        tangent_uN = share * answer[finger] @ tangent[finger]
        n, t = 2 * finger, 2 * finger + 1
        for sign in (1.0, -1.0):
            row = np.zeros(5)
            row[[n, t, 4]] = -friction, sign, 1.0
            rows.append(row)
            limits.append(friction * (normal_uN + law.pull_off_uN) - sign * tangent_uN)
        for slope, room in (
            (-1.0, normal_uN + law.pull_off_uN),
            (friction, friction * (law.max_force_uN - normal_uN)),
        ):
            row = np.zeros(5)
            row[[n, 4]] = slope, 1.0
            rows.append(row)
            limits.append(room)
    balance = np.column_stack([grasp_rows(stay_um, stay_normal), np.zeros(3)])
    scale = np.array([1.0, 1.0, 1.0 / np.max(np.abs(stay_um))])

    def solved(grip_weight, margin_weight, margin_bounds):
        return linprog(
            [*(grip_weight * grip), margin_weight],
            A_ub=np.array(rows),
            b_ub=limits,
            A_eq=scale[:, None] * balance,
            b_eq=np.zeros(3),
            bounds=[(None, None)] * 4 + [margin_bounds],
            method='highs',
        )

    return solved


def preload_window_lp(*removal, margin_uN):
    """Return the least and the largest grip that keep a margin, or None; see `preload_program`."""
    program = preload_program(*removal)
    window = []
    for sign in (1.0, -1.0):
        answer = program(sign, 0.0, (margin_uN, margin_uN))
        if answer.status == 2:
            return None
        assert answer.status == 0, answer.message
        window.append(sign * answer.fun)
    return tuple(window)


def best_margin_lp(*removal):
    """Return the largest margin that any grip keeps; see `preload_program`."""
    answer = preload_program(*removal)(0.0, -1.0, (None, None))
    assert answer.status == 0, answer.message
    return -answer.fun


def presses_lp(contact_um, normal, friction):
    """Return the largest share t, such that forces that sum up to 1 balance with all f_n >= t."""
    fingers = len(contact_um)
    scale = np.max(np.abs(contact_um))
    cone, limit = coulomb_rows(fingers, friction, 0.0)
    at_least = np.zeros((fingers, 2 * fingers + 1))
    at_least[:, -1] = 1.0
    at_least[np.arange(fingers), 2 * np.arange(fingers)] = -1.0
    answer = linprog(
        [*np.zeros(2 * fingers), -1.0],
        A_ub=np.vstack([np.column_stack([cone, np.zeros(len(cone))]), at_least]),
        b_ub=[*limit, *np.zeros(fingers)],
        A_eq=np.vstack(
            [
                np.column_stack([grasp_rows(contact_um / scale, normal), np.zeros(3)]),
                [*([1.0, 0.0] * fingers), 0.0],
            ]
        ),
        b_eq=[0.0, 0.0, 0.0, 1.0],
        bounds=[(0.0, None), (None, None)] * fingers + [(None, 1.0)],
        method='highs',
    )
    return -math.inf if answer.status == 2 else -answer.fun


# ---------------------------------------------------------------- closed forms of another kind


def removable_from(pair_um, pair_normal, leave_um, leave_normal, law, rules=None):
    """Return which of k fingers a pair lets go, (k,) bool: null space of the grasp matrix.

    With `rules`, the same grip must do before the pull and under it, with their margin and
    tolerance; the pseudo-inverse gives the answer of equal springs, see `least_energy_answer`.
    """
    rows = grasp_rows(pair_um, pair_normal)
    pull = law.pull_off_uN * leave_normal
    wrench = np.column_stack([pull, planar_cross(leave_um, pull)])
    particular = -wrench @ np.linalg.pinv(rows).T
    free = np.linalg.svd(rows)[2][-1]
    margin_uN = 0.0 if rules is None else rules.least_margin_uN
    friction = law.friction * (1.0 if rules is None else rules.margin_factor)
    cone, limit = coulomb_rows(2, friction, law.pull_off_uN)
    pick = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
    matrix = np.vstack([cone, -pick, pick])
    least, most = (0.0, law.max_force_uN)
    if rules is not None:
        least, most = margin_uN - law.pull_off_uN, law.max_force_uN - margin_uN / friction
    limits = np.array([*(limit - margin_uN), -least, -least, most, most])
    slope = matrix @ free
    low, high = np.full(len(wrench), -math.inf), np.full(len(wrench), math.inf)
    possible = np.ones(len(wrench), dtype=bool)
    for share in (1.0,) if rules is None else (0.0, 1.0):
        room = limits - share * particular @ matrix.T
        with np.errstate(divide='ignore', invalid='ignore'):
            ends = room / slope
        high = np.minimum(high, np.min(np.where(slope > 1e-12, ends, math.inf), axis=1))
        low = np.maximum(low, np.max(np.where(slope < -1e-12, ends, -math.inf), axis=1))
        possible &= np.all((np.abs(slope) > 1e-12) | (room >= 0.0), axis=1)
    # both ends of `free` press along one line: each is the grip times the square root of a half
    tolerance_uN = 0.0 if rules is None else rules.grip_tolerance_uN
    return possible & ((high - low) * math.sqrt(0.5) >= 2.0 * tolerance_uN) & (low <= high)


def pairs_press(contact_um, normal, friction):
    """Return whether the lines between pairs (k, 2, 2) lie within both friction angles, (k,)."""
    line = contact_um[:, 1] - contact_um[:, 0]
    push = np.stack([-normal[:, 0], normal[:, 1]], axis=1)  # by contact, along the line
    cosine = np.einsum('kci,ki->kc', push, line) / np.linalg.norm(line, axis=1)[:, None]
    return np.all(np.arccos(np.clip(cosine, -1, 1)) <= math.atan(friction), axis=1)


def triples_press(contact_um, normal, friction):
    """Return whether three fingers, (k, 3, 2), can hold with each of them pressing, (k,) bool.

    By Farkas a finger cannot press exactly if a velocity of the object opposes both edges of
    its cone and no edge of any cone helps it. Such velocities form a cone; a sum of its extreme
    rays, which are orthogonal to two edges each, shows whether there is one.
    """
    tangent = np.stack([-normal[..., 1], normal[..., 0]], axis=-1)
    at = contact_um / np.max(np.abs(contact_um))
    edges = np.stack([-normal + friction * tangent, -normal - friction * tangent], axis=2)
    moments = planar_cross(at[:, :, None, :], edges)
    edges = np.concatenate([edges, moments[..., None]], axis=-1).reshape(-1, 6, 3)
    one, other = np.triu_indices(6, k=1)
    forward, back = [1, 2, 0], [2, 0, 1]
    rays = edges[:, one][..., forward] * edges[:, other][..., back]
    rays -= edges[:, one][..., back] * edges[:, other][..., forward]
    rays = np.concatenate([rays, -rays], axis=1)
    work = rays @ edges.transpose(0, 2, 1)
    total = np.sum(rays * np.all(work >= -1e-9, axis=2)[..., None], axis=1)
    work = np.einsum('kei,ki->ke', edges, total).reshape(-1, 3, 2)
    return ~np.any(np.all(work > 1e-9, axis=2), axis=1)
