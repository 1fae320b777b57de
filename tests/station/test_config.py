# SPDX-License-Identifier: Apache-2.0
"""Station files: the shipped one is the default, and every mistake is named."""

from pathlib import Path

import pytest
import yaml

from microhand_planner.core.errors import BadRequest
from microhand_station.config import (
    StationConfig,
    config_from_dict,
    read_config,
    write_config,
)

SHIPPED = Path(__file__).parents[2] / 'ros_ws/src/microhand_station/config/station.yaml'


def test_the_shipped_file_says_what_the_defaults_are():
    """Reading config/station.yaml, and leaving everything out, describe the same station."""
    assert read_config(SHIPPED) == StationConfig() == config_from_dict({})


def test_what_is_written_is_read_back(tmp_path):
    """A station survives the way through a file, integers and driver parameters included."""
    config = config_from_dict(
        {
            'namespace': 'lab/left',
            'motion': {'speed': 2},
            'contact': {'speed_um_s': 2, 'tolerance_um': 0.3},
            'twin': {'enabled': True, 'friction': 0.25, 'pull_off_uN': None},
            'recording': {'required': False, 'on_failure': 'go_on', 'max_message_mb': 2},
            'fingers': [
                {'driver': {'noise_rms': 0.0}},
                {'upper_um': [120, 180, 180.5]},
                {'stiffness_n_per_m': 100},
            ],
        }
    )
    assert config.fingers[1].upper_um == (120.0, 180.0, 180.5)
    assert config.stiffness_uN_per_um == (20.0, 20.0, 100.0)
    assert (config.twin.friction, config.twin.pull_off_uN) == (0.25, None)
    assert config.touch.speed_um_s == 2.0
    write_config(config, tmp_path / 'station.yaml')
    assert read_config(tmp_path / 'station.yaml') == config


def test_speed_scales_every_rate():
    """Twice the speed is twice the roll rate and twice the tip speeds, up to the stage's limit."""
    slow, fast = (config_from_dict({'motion': {'speed': s}}).motion for s in (1.0, 2.0))
    assert fast.pace(500.0).roll_rate_rad_s == 2 * slow.pace(500.0).roll_rate_rad_s
    assert fast.transit_pace(500.0).travel_um_s == 2 * slow.transit_pace(500.0).travel_um_s
    assert fast.pace(500.0).axis_um_s == slow.pace(500.0).axis_um_s == 500.0


def test_the_stiffest_finger_decides_how_slowly_the_object_is_met():
    """Unless the file says how fast: the force of a finger that touched rises by 20 µN/s."""
    assert StationConfig().touch.speed_um_s * 20.0 == 20.0
    stiff = config_from_dict({'fingers': [{}, {'stiffness_n_per_m': 100.0}, {}]})
    assert stiff.touch.speed_um_s * 100.0 == 20.0


@pytest.mark.parametrize(
    ('content', 'message'),
    [
        ([], r'station is \[\]; allowed: a section with namespace, frame, motion'),
        ({'finger': []}, 'station: finger is unknown; allowed: namespace, frame, motion, cont'),
        ({'fingers': [{}, {}]}, r'fingers is \[\{\}, \{\}\]; allowed: a list of 3'),
        ({'motion': {'speed': 'fast'}}, "motion: speed is 'fast'; allowed: a number"),
        ({'motion': {'speed': True}}, 'motion: speed is True; allowed: a number'),
        ({'motion': {'speed': 0}}, 'speed is 0.0; allowed: a number >= 0.01 and <= 20'),
        ({'motion': {'travel_um_s': float('nan')}}, 'motion: travel_um_s is nan'),
        ({'namespace': 'my lab'}, "namespace is 'my lab'; allowed: a ROS name, or empty"),
        ({'frame': 7}, 'frame is 7; allowed: a text'),
        ({'recording': {'required': 'yes'}}, "recording: required is 'yes'; allowed: true or f"),
        (
            {'recording': {'on_failure': 'wait'}},
            "recording: on_failure is 'wait'; allowed: sto",
        ),
        ({'recording': {'max_message_mb': 0}}, 'recording: max_message_mb is 0'),
        ({'recording': {'always': True}}, 'recording: always is unknown; allowed: required, on_f'),
        (
            {'fingers': [{}, {'base_um': [1, 2]}, {}]},
            r'finger 2: base_um is \[1, 2\]; allowed: three numbers x y z',
        ),
        (
            {'fingers': [{}, {}, {'home_um': [50, 50, 220]}]},
            'finger 3: home_um z is 220.0; allowed: 0 to 200',
        ),
        (
            {'fingers': [{'lower_um': [0, 200, 0]}, {}, {}]},
            'finger 1: lower_um y is 200.0; allowed: less than upper_um, 200',
        ),
        (
            {'fingers': [{'max_velocity_um_s': -1}, {}, {}]},
            'finger 1: max_velocity_um_s is -1.0; allowed: a number > 0',
        ),
        ({'fingers': [{'driver': 3}, {}, {}]}, 'finger 1: driver is 3; allowed: names and val'),
        (
            {'fingers': [{}, {}, {'stiffness_n_per_m': 0}]},
            'finger 3: stiffness_n_per_m is 0.0; allowed: a number >= 0.1 and <= 10000',
        ),
        ({'contact': {'speed': 1}}, 'contact: speed is unknown; allowed: speed_um_s, standoff_um'),
        ({'contact': {'speed_um_s': 'slow'}}, "contact: speed_um_s is 'slow'; allowed: a number"),
        ({'contact': {'standoff_um': None}}, 'contact: standoff_um is None; allowed: a number'),
        ({'motion': {'speed': None}}, 'motion: speed is None; allowed: a number'),
        ({'contact': {'speed_um_s': 0}}, 'contact: speed_um_s is 0.0; allowed: a number >= 0.01'),
        (
            {'contact': {'tolerance_um': 0.5}},
            'contact: tolerance_um is 0.5; allowed: less than standoff_um, 0.5',
        ),
        (
            {'tolerances': {'path_um': 0}},
            'tolerances: path_um is 0.0; allowed: a number >= 0.001 and <= 1000',
        ),
        ({'tolerances': {'goal': 1}}, 'tolerances: goal is unknown; allowed: start_um, path_um'),
        ({'twin': {'enabled': 1}}, 'twin: enabled is 1; allowed: true or false'),
        ({'twin': {'friction': -0.1}}, 'twin: friction is -0.1; allowed: a number >= 0 and <= 2'),
        ({'twin': {'pull_off_uN': 'weak'}}, "twin: pull_off_uN is 'weak'; allowed: a number"),
    ],
)
def test_each_mistake_is_named_with_its_value_and_what_is_allowed(tmp_path, content, message):
    """One line says which file, which key, what was found, and what may stand there."""
    path = tmp_path / 'wrong.yaml'
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(BadRequest, match=message) as error:
        read_config(path)
    assert str(error.value).startswith(str(path))
    assert '\n' not in str(error.value)


def test_a_file_that_is_not_there_or_not_yaml_is_refused(tmp_path):
    """Neither a missing file nor broken YAML ends in a traceback."""
    with pytest.raises(BadRequest, match='No such file'):
        read_config(tmp_path / 'missing.yaml')
    (tmp_path / 'broken.yaml').write_text('fingers: [')
    with pytest.raises(BadRequest, match='allowed: a YAML file'):
        read_config(tmp_path / 'broken.yaml')
