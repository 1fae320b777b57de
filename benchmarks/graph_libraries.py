# SPDX-License-Identifier: Apache-2.0
"""The second rotation of the paper's ellipsoid, by our search and by graph libraries.

All begin with the ellipse, or with the path of the tip around it, which is the same for all. Each
peer gets the explicit graph of [Kumar2021] §3.3 as arrays, builds its own structure and searches
it; all of that counts, as the contact points and tables count for us. Peers run in processes of
their own, one after the other. All answers must cost the same.

    python benchmarks/graph_libraries.py
"""

from __future__ import annotations

import gc
import itertools
import json
import math
import resource
import subprocess
import sys
import time
from collections.abc import Callable

import networkx as nx
import numpy as np
import rustworkx as rx
import scipy.sparse
from explicit_graph import ExplicitGraph, explicit_graph
from record import cpu_time_s, write
from scipy.sparse import csgraph

from microhand_planner.core.analytic_sections import ellipse_section
from microhand_planner.core.decomposition import PlanarRotation
from microhand_planner.core.interruption import uninterrupted
from microhand_planner.core.offset_curve import OffsetCurve, offset_curve
from microhand_planner.core.parameters import Mode, SearchOptions
from microhand_planner.core.planar import solve_planar
from microhand_planner.core.planar_problem import Node, PlanarProblem
from microhand_planner.core.planned_rotation import Problem, plan_planar_rotation
from microhand_planner.core.search_state import NDEG
from microhand_planner.core.section import XY_PLANE
from microhand_planner.evaluation.speed import measure
from microhand_planner.evaluation.table3 import CONTACTS, ELLIPSE_UM, START

QUERIES: dict[str, tuple[Node, bool]] = {
    # what is asked: a goal, and whether fingers are alike, so that any of the six goals will do
    'cheapest goal of Table 3': ((38, 0, 1, 12), False),
    'dearest goal of Table 3': ((1, 38, 0, 12), False),
    'best of the six goals': ((38, 1, 0, 12), True),
}
MEMORY_LIMIT_BYTES = 16 * 1024**3
CHUNK = 1_000_000  # edges handed over at once
OUT_OF_MEMORY = 'out of memory (16 GB)'


def problem_to(goal: Node) -> PlanarProblem:
    """Return the rotation by 220 deg."""
    return PlanarProblem(ELLIPSE_UM, CONTACTS, 20.0, 19, START, goal)


def curve_of(problem: PlanarProblem) -> OffsetCurve:
    """Return the path of the tip around the ellipse: where both sides begin."""
    return offset_curve(ellipse_section(*problem.ellipse_um, XY_PLANE), problem.finger.radius_um)


def ours(goal: Node, alike: bool, curve: OffsetCurve) -> float:
    """Search our way, from the path of the tip to the cost [deg]."""
    problem = problem_to(goal)
    if not alike:
        answer = solve_planar(problem, curve=curve)
        if answer.cost_deg is None:
            raise RuntimeError('no path')
        return answer.cost_deg
    joints = (0.0, curve.phase_of_joint_j)
    request = Problem(
        problem.finger,
        problem.law,
        SearchOptions(mode=Mode.PAPER),
        time.monotonic,
        uninterrupted(),
    )
    turn = PlanarRotation('z', math.radians(problem.step_deg * (goal[3] - START[3])))
    planned, _ = plan_planar_rotation(turn, curve, request, joints, joints)
    if planned is None:
        raise RuntimeError('no path')
    return planned.cost_ndeg / NDEG


def scipy_dijkstra(graph: ExplicitGraph) -> Callable[[], float]:
    """Search with scipy: no A*, so it finds the way to every node."""
    shape = (len(graph), len(graph))
    matrix = scipy.sparse.csr_array((graph.cost_deg, (graph.source, graph.target)), shape)
    start, goal = graph.number(graph.problem.start), graph.number(graph.problem.goal)
    return lambda: float(csgraph.dijkstra(matrix, indices=start)[goal])


def rustworkx_astar(graph: ExplicitGraph) -> Callable[[], float]:
    """Search with A* in Rust; heuristic and goal test are asked of Python."""
    library = rx.PyDiGraph()
    library.add_nodes_from(range(len(graph)))
    for edges in _edges(graph):
        library.add_edges_from(edges)
    start, goal = graph.number(graph.problem.start), graph.number(graph.problem.goal)
    estimate = graph.heuristic_deg().tolist()

    def search() -> float:
        path = rx.digraph_astar_shortest_path(
            library, start, lambda node: node == goal, float, estimate.__getitem__
        )
        return sum(library.get_edge_data(*step) for step in itertools.pairwise(path))

    return search


def networkx_astar(graph: ExplicitGraph) -> Callable[[], float]:
    """Search with A* in Python."""
    gc.disable()  # nothing here is garbage, and looking for it takes longer than building
    library = nx.DiGraph()
    library.add_nodes_from(range(len(graph)))
    for edges in _edges(graph):
        library.add_weighted_edges_from(edges)
    start, goal = graph.number(graph.problem.start), graph.number(graph.problem.goal)
    estimate = graph.heuristic_deg().tolist()
    return lambda: nx.astar_path_length(library, start, goal, lambda node, _: estimate[node])


def _edges(graph: ExplicitGraph):
    """Yield the edges as lists of tuples, a chunk at a time."""
    for begin in range(0, len(graph.source), CHUNK):
        chunk = slice(begin, begin + CHUNK)
        columns = (graph.source, graph.target, graph.cost_deg)
        yield list(zip(*(column[chunk].tolist() for column in columns), strict=True))


PEERS = {
    'scipy csgraph, Dijkstra': scipy_dijkstra,
    'rustworkx, A*': rustworkx_astar,
    'networkx, A*': networkx_astar,
}


def run_peer(query: str, peer: str) -> dict[str, object]:
    """Measure one peer on one query, in this process."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT_BYTES, MEMORY_LIMIT_BYTES))
    goal, alike = QUERIES[query]
    small = PlanarProblem((10.0, 9.0), 40, 20.0, 2, (1, 21, 0, 1), (1, 21, 0, 2))
    explicit_graph(small, curve_of(small), alike=alike).heuristic_deg()  # loads compiled parts
    try:
        started = cpu_time_s()
        curve = curve_of(problem_to(goal))
        curve_s = cpu_time_s() - started
        graph = explicit_graph(problem_to(goal), curve, alike=alike)
        arrays_s = cpu_time_s() - started
        search = PEERS[peer](graph)
        built_s = cpu_time_s() - started
        cost_deg = search()
        total_s = cpu_time_s() - started
    except MemoryError:
        return {'peer': peer, 'query': query, 'error': OUT_OF_MEMORY}
    return {
        'query': query,
        'peer': peer,
        'nodes': len(graph),
        'edges': len(graph.source),
        'cost_deg': cost_deg,
        'curve_s': curve_s,
        'arrays_s': arrays_s - curve_s,
        'structure_s': built_s - arrays_s,
        'search_s': total_s - built_s,
        'total_s': total_s,
        'peak_memory_gb': resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2,
    }


def run_ours(query: str) -> dict[str, object]:
    """Measure our search on one query."""
    goal, alike = QUERIES[query]
    problem = problem_to(goal)
    curve = curve_of(problem)
    search = measure(lambda: ours(goal, alike, curve), cpu_time_s)
    whole = measure(lambda: ours(goal, alike, curve_of(problem)), cpu_time_s)
    return {
        'query': query,
        'peer': 'microhand',
        'cost_deg': ours(goal, alike, curve),
        'runs': whole.runs,
        'search_s': search.median_s,
        'total_s': whole.median_s,
    }


def main() -> None:
    """Measure everything, print a line each, and write the results."""
    rows = []
    for query in QUERIES:
        own = run_ours(query)
        print(f'{query}: microhand {own["total_s"] * 1e3:.2f} ms', flush=True)
        rows.append(own)
        for peer in PEERS:
            child = subprocess.run(
                [sys.executable, __file__, query, peer],
                capture_output=True,
                text=True,
                check=False,
            )
            if child.returncode != 0:  # the kernel, or the library, gave up
                row: dict[str, object] = {'query': query, 'peer': peer, 'error': OUT_OF_MEMORY}
            else:
                row = json.loads(child.stdout)
            if 'total_s' in row:
                if not np.isclose(row['cost_deg'], own['cost_deg']):
                    raise RuntimeError(f'{peer} finds {row["cost_deg"]}, not {own["cost_deg"]}')
                row['times_slower'] = row['total_s'] / own['total_s']
                given_s = row['total_s'] - row['curve_s']
                row['times_slower_curve_given'] = given_s / own['search_s']
                said = f'{row["total_s"]:.2f} s, {row["times_slower"]:.0f} times slower, '
                said += f'the curve given {row["times_slower_curve_given"]:.0f} times'
            else:
                said = str(row['error'])
            print(f'  {peer}: {said}', flush=True)
            rows.append(row)
    print(write('graph_libraries', rows, ('numpy', 'scipy', 'networkx', 'rustworkx', 'numba')))


if __name__ == '__main__':
    if len(sys.argv) == 3:
        print(json.dumps(run_peer(sys.argv[1], sys.argv[2])))
    else:
        main()
