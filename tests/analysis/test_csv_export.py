# SPDX-License-Identifier: Apache-2.0
"""Tables of a record against an independent reader of the same file."""

import csv
import json
import math

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from microhand_planner.core.errors import BadRequest
from microhand_station.analysis.csv_export import Slice, export_csv
from microhand_station.analysis.record_index import record_index
from microhand_station.analysis.schema_units import schema_units
from microhand_station.cli.app import main


def read(path):
    """Return the head and the rows of a table."""
    with path.open(encoding='utf-8', newline='') as stream:
        head, *rows = csv.reader(stream)
    assert all(len(row) == len(head) for row in rows), 'every row has every column'
    return head, rows


def column(path, name):
    """Return one column as numbers; blank: NaN."""
    head, rows = read(path)
    at = head.index(name)
    return np.array([float(row[at]) if row[at] else math.nan for row in rows])


@pytest.fixture(scope='module')
def tables(record, tmp_path_factory):
    """Return the folder with the tables of the whole record."""
    folder = tmp_path_factory.mktemp('csv')
    _, damaged = export_csv(record, record_index(record), folder)
    assert damaged == 0
    return folder


@pytest.fixture(scope='module')
def messages(record):
    """Return the messages of each topic, by rosbags, with their log times."""
    found = {}
    with AnyReader([record]) as reader:
        for connection, time_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append((time_ns, message))
    return found


def test_states_are_those_of_an_independent_reader(tables, messages):
    """Positions in metres to the last bit, times to the nanosecond, one row per message."""
    states = messages['/finger_2/state']
    path = tables / 'finger_2.state.csv'
    expected = [message.position.y for _, message in states]
    np.testing.assert_array_equal(column(path, 'position.y [m]'), expected)
    head, rows = read(path)
    assert head[:2] == ['time [s]', 'header.stamp [s]']
    first_ns = min(time_ns for topic in messages.values() for time_ns, _ in topic)
    for row, (time_ns, message) in zip(rows, states, strict=True):
        assert row[0] == f'{(time_ns - first_ns) / 1e9:.9f}'
        stamp = message.header.stamp
        assert row[1] == f'{stamp.sec}.{stamp.nanosec:09d}'


def test_each_setpoint_is_a_row(tables, messages):
    """Chunks are taken apart: x, y and z of each setpoint, numbered within its chunk."""
    path = tables / 'finger_1.setpoints.csv'
    flat = np.concatenate([message.positions for _, message in messages['/finger_1/setpoints']])
    found = np.stack([column(path, f'positions.{axis} [m]') for axis in 'xyz'], axis=1)
    np.testing.assert_array_equal(found, flat.reshape(-1, 3))
    assert column(path, 'row')[:26].tolist() == [*range(1, 26), 1]


def test_contacts_of_the_object_stand_side_by_side(tables, messages):
    """One row per report, with the three fingers beside each other; no contact is blank."""
    path = tables / 'object_state.csv'
    expected = [message.contacts[2].force.z for _, message in messages['/object_state']]
    np.testing.assert_array_equal(column(path, 'contacts.finger_3.force.z [N]'), expected)
    use = column(path, 'contacts.finger_1.friction_use')
    touches = [message.contacts[0].in_contact for _, message in messages['/object_state']]
    np.testing.assert_array_equal(np.isfinite(use), touches)
    assert 'contacts.finger_1.normal_force [N]' in read(path)[0]


def test_waypoints_of_the_plan_are_rows_and_rotations_a_table_of_their_own(tables, made):
    """As many rows as the plan has waypoints; the tips are those of the plan."""
    plan = made.plan()
    path = tables / 'plan.csv'
    tips_um = np.concatenate([step.tip_um for step in plan.steps])
    found_um = 1e6 * column(path, 'steps.tip_positions.finger_2.y [m]')
    np.testing.assert_allclose(found_um, tips_um[:, 1, 1], atol=1e-9)
    numbers = np.repeat(np.arange(1, 15), [len(step) for step in plan.steps])
    np.testing.assert_array_equal(column(path, 'number'), numbers)
    angles = column(tables / 'plan.rotations.csv', 'rotations.angle [rad]')
    expected = [math.radians(rotation.angle_deg) for rotation in plan.rotations]
    np.testing.assert_allclose(angles, expected)


def test_a_slice_holds_what_was_recorded_in_it(record, tmp_path, tables):
    """From 2 s to 3 s, ends included: the same rows as those of the whole table."""
    part = Slice(2.0, 3.0)
    (table,), _ = export_csv(record, record_index(record), tmp_path, ['finger_1/state'], part)
    whole = read(tables / 'finger_1.state.csv')[1]
    assert read(table.path)[1] == [row for row in whole if 2.0 <= float(row[0]) <= 3.0]
    assert table.rows > 90


def test_command_says_what_it_wrote(record, tmp_path, capsys):
    """`microhand export --json` names files and rows; a second time it refuses to overwrite."""
    folder = tmp_path / 'new' / 'tables'
    arguments = ['export', str(record), '--csv', str(folder), '--topic', '/plan', '--json']
    assert main(arguments) == 0
    tables = json.loads(capsys.readouterr().out)['tables']
    assert [table['file'] for table in tables] == [
        str(folder / name) for name in ('plan.csv', 'plan.rotations.csv', 'plan.options.csv')
    ]
    before = (folder / 'plan.csv').read_bytes()
    assert main(arguments) == 2
    assert 'allowed: a folder in which no table of this name is' in capsys.readouterr().err
    assert (folder / 'plan.csv').read_bytes() == before


@pytest.mark.parametrize(
    ('options', 'says'),
    [
        (['--topic', 'nothing'], 'topic is /nothing; allowed: /events, /finger_1/contact'),
        (['--from', '3', '--to', '2'], 'to is 2 s; allowed: from 3 s on'),
        (['--from', 'nan'], 'to is inf s; allowed: from nan s on'),
    ],
)
def test_wrong_wishes_are_one_clear_line(record, tmp_path, capsys, options, says):
    """The option at fault, and what is allowed; exit status 2."""
    assert main(['export', str(record), '--csv', str(tmp_path / 'out'), *options]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count('\n') == 1


def test_columns_that_come_late_are_there_from_the_first_row(made, tmp_path):
    """Contacts reported only from the middle of a run on: earlier rows are blank there."""
    from made_run import NAMES  # noqa: F401 - proves that the fixture has imported it
    from microhand_msgs_py.msg import ObjectState
    from rclpy.serialization import serialize_message

    from microhand_station.recording.ros2msg_schema import ros2msg_schema
    from microhand_station.recording.run_writer import RunWriter

    name = 'microhand_msgs_py/msg/ObjectState'
    writer = RunWriter((tmp_path / 'late.mcap').open('xb'), {})
    writer.add_topic('/object_state', name, ros2msg_schema(name), '')
    contacts = made._contacts(np.ones((3, 3)), [True] * 3)
    for number, reported in enumerate(([], [], contacts)):
        message = serialize_message(ObjectState(contacts=reported))
        writer.write('/object_state', message, number, number)
    writer.close('complete')
    index = record_index(tmp_path / 'late.mcap')
    (table,), _ = export_csv(tmp_path / 'late.mcap', index, tmp_path / 'csv')
    use = column(table.path, 'contacts.finger_2.friction_use')
    assert np.isnan(use[:2]).all()
    assert use[2] == pytest.approx(0.2)


def test_units_are_read_from_comments_and_handed_down():
    """By hand: a unit before a field of three numbers is that of each; [-] is none."""
    schema = (
        'Time stamp  # when\nPoint place  # [m] where\nfloat64 share  # [-] 0 to 1\n'
        'float64[] many  # [N] n x 3\nuint8 KIND=3  # [s] a constant\nInner inner\n'
        + '=' * 80
        + '\nMSG: demo_msgs/Point\nfloat64 x\nfloat64 y\n'
        + '=' * 80
        + '\nMSG: demo_msgs/Inner\nfloat64 angle  # [rad] turned\n'
    )
    assert schema_units('demo_msgs/msg/Demo', schema) == {
        'place.x': 'm',
        'place.y': 'm',
        'many': 'N',
        'inner.angle': 'rad',
    }


def test_export_names_a_folder_that_cannot_be_written(record, tmp_path):
    """A file in the place of the folder: one clear error."""
    (tmp_path / 'file').write_text('in the way')
    with pytest.raises(BadRequest, match='csv is'):
        export_csv(record, record_index(record), tmp_path / 'file' / 'csv')
