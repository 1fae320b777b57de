# SPDX-License-Identifier: Apache-2.0
"""Independent answers for the planner's tests, written from the paper without the planner's code.

Contacts on an ellipse come from elliptic integrals, removals from linear programs (HiGHS) or from
the null space of the grasp matrix, stability from a theorem of the alternative, and cheapest paths
from Dijkstra on the paper's whole graph, three-finger grasps included ([Kumar2021] §3.3, §4.1).
"""

import heapq
import itertools
import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.optimize import linprog
from scipy.special import ellipeinc

NO_FINGER = -1
ALONG_THE_WAY_RAD = math.radians(2.0)


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


def removable_from(pair_um, pair_normal, leave_um, leave_normal, law):
    """Return which of k fingers a pair lets go, (k,) bool: null space of the grasp matrix."""
    rows = grasp_rows(pair_um, pair_normal)
    pull = law.pull_off_uN * leave_normal
    wrench = np.column_stack([pull, planar_cross(leave_um, pull)])
    particular = -wrench @ np.linalg.pinv(rows).T
    free = np.linalg.svd(rows)[2][-1]
    cone, limit = coulomb_rows(2, law.friction, law.pull_off_uN)
    pick = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
    matrix = np.vstack([cone, -pick, pick])
    limits = np.array([*limit, 0.0, 0.0, law.max_force_uN, law.max_force_uN])
    slope = matrix @ free
    room = limits - particular @ matrix.T
    with np.errstate(divide='ignore', invalid='ignore'):
        ends = room / slope
    high = np.min(np.where(slope > 1e-12, ends, math.inf), axis=1)
    low = np.max(np.where(slope < -1e-12, ends, -math.inf), axis=1)
    return (low <= high) & np.all((np.abs(slope) > 1e-12) | (room >= 0.0), axis=1)


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


# ---------------------------------------------------------------- the paper's graph


@dataclass
class Lattice:
    """Contacts, orientations, and how contacts follow each other when the object turns.

    `standing[l]`: contacts on which a finger may be placed at orientation l;
    `forward[l]`: contact at l to the contact at l + 1 of a finger that rolls.
    """

    phase_rad: np.ndarray
    theta_deg: np.ndarray
    standing: list
    forward: list
    roll_phase_rad: list = field(default_factory=list)

    def contact_at(self, phase_rad, turn_rad):
        """Return the contact at a phase."""
        gap = np.abs((self.phase_rad - phase_rad + turn_rad / 2) % turn_rad - turn_rad / 2)
        assert np.min(gap) < 1e-6
        return int(np.argmin(gap))


def paper_lattice(shape, contacts, step_deg, orientations):
    """Return the lattice of the paper: contact i at l becomes contact i - 1 at l + 1."""
    every = list(range(contacts))
    return Lattice(
        phase_rad=np.arange(contacts) * shape.turn_rad / contacts,
        theta_deg=np.arange(orientations) * step_deg,
        standing=[every] * orientations,
        forward=[{i: (i - 1) % contacts for i in every}] * (orientations - 1),
        roll_phase_rad=[np.zeros(0)] * (orientations - 1),
    )


def robust_lattice(turn_rad, step_rad, angle_rad, start_phases, goal_phases):
    """Return the lattice of exact phases for a rotation by `angle_rad`.

    Tracks: multiples of the fitted step, and those through the wanted phases at start and goal.
    Orientations: multiples within one turn either way, and the goal.
    """
    spacing = turn_rad / math.ceil(turn_rad / step_rad - 1e-9)
    most = math.floor(2 * math.pi / spacing + 1e-9)
    theta = sorted({round(k * spacing, 10) for k in range(-most, most + 1)})
    if min(abs(angle_rad - there) for there in theta) > 1e-8:
        theta = sorted([*theta, angle_rad])
    tracks = list(np.arange(0, turn_rad - 1e-9, spacing))
    for track in [*start_phases, *(phase + angle_rad for phase in goal_phases)]:
        if min(abs(math.remainder(track - there, turn_rad)) for there in tracks) > 1e-8:
            tracks.append(track % turn_rad)
    number = {}

    def name(phase):
        return number.setdefault(round(phase % turn_rad, 7) % round(turn_rad, 7), len(number))

    standing = [[name(track - at) for track in tracks] for at in theta]
    phase_rad = np.array(list(number))
    along = [
        np.linspace(0, after - at, math.ceil((after - at) / ALONG_THE_WAY_RAD) + 1)[1:-1]
        for at, after in itertools.pairwise(theta)
    ]
    forward = [dict(zip(here, there, strict=True)) for here, there in itertools.pairwise(standing)]
    return Lattice(phase_rad, np.degrees(theta), standing, forward, along)


class PaperGraph:
    """The graph of [Kumar2021] §3.3. A node is (i, j, k, l): contacts or `NO_FINGER`, orientation.

    Parameters
    ----------
    shape : object
        With ``at(phase_rad)`` and ``turn_rad``, as `Ellipse`.
    lattice : Lattice
        Where fingers may stand.
    law, min_distance_um
        Contact law, and least distance of two tip centres.
    """

    def __init__(self, shape, lattice, law, min_distance_um):
        self.shape, self.lattice, self.law = shape, lattice, law
        self.min_distance_um = min_distance_um
        self.contact, self.normal, self.centre = shape.at(lattice.phase_rad)
        apart = np.linalg.norm(self.centre[:, None] - self.centre[None, :], axis=2)
        self.apart = apart >= min_distance_um - 1e-9
        self.backward = [{b: a for a, b in step.items()} for step in lattice.forward]
        self.known_pairs, self.known_triples, self.known_removals = {}, {}, {}
        self.known_rolls, self.known_rolling, self.known_apart = {}, {}, {}

    def holds(self, grasp):
        """Return whether a set of two or three contacts is a stable grasp."""
        if len(grasp) == 2:
            one, other = grasp
            if grasp not in self.known_pairs:
                self.known_pairs[grasp] = self.apart[one, other] and (
                    self.law.adhesion
                    or pairs_press(
                        self.contact[None, [one, other]],
                        self.normal[None, [one, other]],
                        self.law.friction,
                    )[0]
                )
            return self.known_pairs[grasp]
        one, two, three = sorted(grasp)
        if not (self.apart[one, two] and self.apart[two, three] and self.apart[one, three]):
            return False
        if self.law.adhesion:
            return True
        if (one, two) not in self.known_triples:
            every = np.arange(len(self.contact))
            rows = np.column_stack([np.full_like(every, one), np.full_like(every, two), every])
            self.known_triples[one, two] = triples_press(
                self.contact[rows], self.normal[rows], self.law.friction
            )
        return self.known_triples[one, two][three]

    def lets_go(self, pair, leave):
        """Return whether a pair holds while a third finger is removed, [Kumar2021] Eq. 4."""
        if not self.law.adhesion:
            return self.holds(pair)
        if pair not in self.known_removals:
            self.known_removals[pair] = removable_from(
                self.contact[list(pair)], self.normal[list(pair)],
                self.contact, self.normal, self.law,
            )  # fmt: skip
        return self.holds(pair) and self.known_removals[pair][leave]

    def rolls(self, grasp, lower):
        """Return whether a grasp holds strictly between orientation `lower` and the next."""
        if not len(self.lattice.roll_phase_rad[lower]):
            return True
        key = (tuple(sorted(grasp)), lower)
        if key not in self.known_rolls:
            self.known_rolls[key] = self._holds_along(*key)
        return self.known_rolls[key]

    def _rolling(self, contact, lower):
        """Return contact, normal and tip centre (n, 2) of a finger while it rolls, read once."""
        if (contact, lower) not in self.known_rolling:
            along = self.lattice.roll_phase_rad[lower]
            points = self.shape.at(self.lattice.phase_rad[contact] - along)
            self.known_rolling[contact, lower] = points
        return self.known_rolling[contact, lower]

    def _holds_along(self, grasp, lower):
        if len(grasp) == 3 and not all(
            self._apart_along(pair, lower) for pair in itertools.combinations(grasp, 2)
        ):
            return False
        if len(grasp) == 2 and not self._apart_along(grasp, lower):
            return False
        if self.law.adhesion:
            return True
        contact, normal, _ = (
            np.stack(parts, axis=1)
            for parts in zip(*(self._rolling(c, lower) for c in grasp), strict=True)
        )
        press = pairs_press if len(grasp) == 2 else triples_press
        return bool(np.all(press(contact, normal, self.law.friction)))

    def _apart_along(self, pair, lower):
        if (pair, lower) not in self.known_apart:
            one, other = (self._rolling(contact, lower)[2] for contact in pair)
            least_um = np.min(np.linalg.norm(one - other, axis=1))
            self.known_apart[pair, lower] = least_um >= self.min_distance_um - 1e-9
        return self.known_apart[pair, lower]

    def neighbours(self, node):
        """Yield the nodes that one operation leads to, and its cost [deg]."""
        *fingers, at = node
        placed = [finger for finger in range(3) if fingers[finger] != NO_FINGER]
        grasp = tuple(fingers[finger] for finger in placed)
        theta = self.lattice.theta_deg
        for after, tables in ((at + 1, self.lattice.forward), (at - 1, self.backward)):
            lower = min(at, after)
            if not 0 <= after < len(theta) or any(c not in tables[lower] for c in grasp):
                continue
            rolled = [tables[lower].get(contact, NO_FINGER) for contact in fingers]
            base = grasp if after > at else tuple(rolled[finger] for finger in placed)
            if self.holds(tuple(rolled[finger] for finger in placed)) and self.rolls(base, lower):
                yield (*rolled, after), len(placed) * abs(theta[after] - theta[at])
        for finger in range(3):
            changed = list(fingers)
            if len(placed) == 3:
                changed[finger] = NO_FINGER
                if self.lets_go(tuple(c for c in changed if c != NO_FINGER), fingers[finger]):
                    yield (*changed, at), 180.0
            elif finger not in placed:
                for contact in self.lattice.standing[at]:
                    if self.holds((*grasp, contact)):
                        changed[finger] = contact
                        yield (*changed, at), 180.0

    def grasps_of_two(self, at, pairs=None):
        """Return all nodes with two fingers at an orientation; or those with given contacts."""
        if pairs is None:
            pairs = itertools.combinations(self.lattice.standing[at], 2)
        return [(*pair, NO_FINGER, at) for pair in pairs if self.holds(pair)]

    def reached(self, starts, goals, *, named=True):
        """Yield goals and what the cheapest path from any start costs [deg], cheapest first.

        named: False if fingers are alike, so that nodes that differ in their names only are one.
        """

        def name(node):
            return node if named else (*sorted(node[:3]), node[3])

        goals = set(map(name, goals))
        starts = {
            name(node) for node in starts if self.holds(tuple(c for c in node[:3] if c >= 0))
        }
        costs = dict.fromkeys(starts, 0.0)
        queue = [(0.0, node) for node in starts]
        heapq.heapify(queue)
        while queue and goals:
            cost, node = heapq.heappop(queue)
            if cost > costs[node]:
                continue
            if node in goals:
                goals.remove(node)
                yield node, cost
            for other, price in self.neighbours(node):
                if cost + price < costs.get(name(other), math.inf) - 1e-9:
                    costs[name(other)] = cost + price
                    heapq.heappush(queue, (cost + price, name(other)))

    def cheapest(self, starts, goals, *, named=True):
        """Return the cost of the cheapest path from any start to any goal [deg], or None."""
        return next((cost for _, cost in self.reached(starts, goals, named=named)), None)
