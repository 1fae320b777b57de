# SPDX-License-Identifier: Apache-2.0
"""The paper's whole graph, and cheapest paths on it by Dijkstra: the oracle of the searches.

Written from [Kumar2021] §3.3 and §4.1: grasps of two and of three fingers, rolls with all of them,
placements and removals. It has nothing of the planner's code, and none of its short cuts.
"""

import heapq
import itertools
import math
from dataclasses import dataclass, field

import numpy as np

from tests.planner.oracles import pairs_press, removable_from, triples_press

NO_FINGER = -1
ALONG_THE_WAY_RAD = math.radians(2.0)


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
    rules
        Margins that removals keep, or None: [Kumar2021] Eq. 4.
    """

    def __init__(self, shape, lattice, law, min_distance_um, rules=None):
        self.shape, self.lattice, self.law, self.rules = shape, lattice, law, rules
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
                self.contact, self.normal, self.law, self.rules,
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
