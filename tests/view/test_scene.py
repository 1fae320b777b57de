# SPDX-License-Identifier: Apache-2.0
"""The scene shows what the snapshot says: through the handles of a real server of viser."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from microhand_planner.core.part import load_part
from microhand_planner.core.pose import Pose
from microhand_station.sequencer.stage_watch import Mode
from microhand_station.sequencer.states import State
from microhand_station.view.address import ViewAddress
from microhand_station.view.figures import figure_of, force_arrow
from microhand_station.view.page_server import open_page_server
from microhand_station.view.scene import LOST_COLOR, OBJECT_COLOR, StationScene
from microhand_station.view.snapshot import Contact, Snapshot, Stage, Thing

TURNED = Pose.of((1.0, 2.0, 3.0), Rotation.from_rotvec([0.1, 0.2, 0.3]))
STIFFNESS = (10.0, 20.0, 40.0)


@pytest.fixture(scope='module')
def server():
    """Serve a page that nobody looks at."""
    server = open_page_server(ViewAddress(port=0), '')
    yield server
    server.stop()


@pytest.fixture
def scene(server, sphere_mesh):
    """Return the scene of a station with the sphere, empty."""
    server.scene.reset()
    figure = figure_of(load_part(sphere_mesh))
    return StationScene(server.scene, lambda _: figure)


def node(server, name):
    """Return a node of the scene; None: there is none."""
    return server.scene._handle_from_node_name.get(name)


def stage(x_um):
    """Return a stage that holds with its tip on the x axis."""
    return Stage(Mode.HOLDING, True, '', np.array([x_um, 0.0, 0.0]), 0.0)


def touching(x_um, force_x_uN):
    """Return a contact on the x axis."""
    point, force = np.array([x_um, 0.0, 0.0]), np.array([force_x_uN, 0.0, 0.0])
    return Contact(True, point, force, abs(force_x_uN), 0.3)


FREE = Contact(False, np.full(3, np.nan), np.zeros(3), 0.0, np.nan)


@pytest.fixture
def snapshot(sphere_plan):
    """Return a station that rolls the sphere between fingers 1 and 2; stage 3 is silent."""
    contacts = (touching(12.0, -3.0), touching(-12.0, 3.0), FREE)
    return Snapshot(
        state=State.RUNNING,
        stages=(stage(16.2), stage(-16.35), None),
        thing=Thing(TURNED, True, True, '', contacts),
        plan=sphere_plan(40.0),
        stiffness_uN_per_um=STIFFNESS,
    )


def test_the_object_is_where_the_twin_reports_it_and_red_when_lost(server, scene, snapshot):
    """Pose to the last digit; the colour tells held from lost."""
    scene.show(snapshot)
    shown = node(server, '/object')
    np.testing.assert_array_equal(shown.position, TURNED.position_um)
    np.testing.assert_array_equal(shown.wxyz, TURNED.quaternion_wxyz)
    assert (shown.visible, node(server, '/object/body').color) == (True, OBJECT_COLOR)
    scene.show(replace(snapshot, thing=replace(snapshot.thing, held=False)))
    assert node(server, '/object/body').color == LOST_COLOR
    scene.show(replace(snapshot, thing=None))
    assert not node(server, '/object').visible


def test_tips_are_where_springs_end_and_silent_ones_are_hidden(server, scene, snapshot):
    """A finger of stiffness k that presses with f is f/k short of where its stage has it."""
    scene.show(snapshot)
    first, second, third = (node(server, f'/tips/{finger}') for finger in (1, 2, 3))
    np.testing.assert_allclose(first.position, [16.2 + 3.0 / 10.0, 0.0, 0.0])
    np.testing.assert_allclose(second.position, [-16.35 - 3.0 / 20.0, 0.0, 0.0])
    assert [tip.visible for tip in (first, second, third)] == [True, True, False]
    assert first.radius == snapshot.plan.finger.radius_um


def test_forces_are_arrows_where_there_is_contact(server, scene, snapshot):
    """Those of fingers in the air are hidden."""
    scene.show(snapshot)
    arrows = [node(server, f'/forces/{finger}') for finger in (1, 2, 3)]
    assert [arrow.visible for arrow in arrows] == [True, True, False]
    expected = force_arrow(snapshot.thing.contacts[1])
    np.testing.assert_allclose(arrows[1].points[0], expected, atol=1e-5)
    scene.show(replace(snapshot, thing=replace(snapshot.thing, contacts=())))
    assert not any(arrow.visible for arrow in arrows)


def test_planned_ways_are_shown_while_a_plan_is_executed(server, scene, snapshot):
    """Three ways and the goal; gone when the sequencer is idle again."""
    scene.show(snapshot)
    names = [*(f'/planned/way_{finger}' for finger in (1, 2, 3)), '/planned/goal']
    assert all(node(server, name) is not None for name in names)
    np.testing.assert_array_equal(
        node(server, '/planned/goal').wxyz, snapshot.plan.goal.quaternion_wxyz
    )
    scene.show(replace(snapshot, state=State.IDLE))
    assert not any(node(server, name) for name in names)


def test_an_empty_station_can_be_shown(server, scene):
    """Nothing known: nothing visible, and nothing breaks."""
    scene.show(Snapshot())
    shown = ['/object', *(f'/{kind}/{n}' for kind in ('tips', 'forces') for n in (1, 2, 3))]
    assert not any(node(server, name).visible for name in shown)
