# SPDX-License-Identifier: Apache-2.0
"""Station file to checked values: what a station consists of, and how fast it moves.

Lengths in µm, angles in degrees, times in s: the unit is in the name of each key.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import yaml

from microhand_planner.core.errors import BadRequest, InvalidParameter
from microhand_planner.core.motions import Touch
from microhand_planner.core.parameters import check_number
from microhand_planner.core.plan import FINGERS
from microhand_planner.core.trajectory import Pace
from microhand_planner.core.travel import AXES, StageLimits
from microhand_station.contact_config import STIFFNESS_N_PER_M, ContactConfig, TwinConfig
from microhand_station.recording_config import RecordingConfig
from microhand_station.tolerance_config import ToleranceConfig

Vector = tuple[float, float, float]
Made = TypeVar('Made')

NAME = re.compile(r'^[A-Za-z][A-Za-z0-9_]*$')
NAMESPACE = re.compile(r'^(/?[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*)?$')


@dataclass(frozen=True)
class FingerConfig:
    """One finger and its stage; the axes of the stage are parallel to the station's.

    Parameters
    ----------
    base_um : (3,) float
        Tip in the station when the stage is at zero [µm].
    lower_um, upper_um, home_um : (3,) float
        Travel and home position, stage frame [µm].
    max_velocity_um_s : float
        Per axis [µm/s].
    stiffness_n_per_m : float
        Of the finger between stage and tip, in all directions [N/m = µN/µm].
    driver : mapping
        Further parameters of the stage driver, by their ROS names, in SI units.
    """

    base_um: Vector = (-100.0, -100.0, -100.0)
    lower_um: Vector = (0.0, 0.0, 0.0)
    upper_um: Vector = (200.0, 200.0, 200.0)
    home_um: Vector = (100.0, 100.0, 100.0)
    max_velocity_um_s: float = 3500.0
    stiffness_n_per_m: float = STIFFNESS_N_PER_M
    driver: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check that the travel is a range, and home within it."""
        check_number('max_velocity_um_s', self.max_velocity_um_s, low=0.0, high=1e6, low_open=True)
        check_number('stiffness_n_per_m', self.stiffness_n_per_m, low=0.1, high=1e4)
        for axis, lower, upper, home in zip(
            AXES, self.lower_um, self.upper_um, self.home_um, strict=True
        ):
            if not lower < upper:
                raise InvalidParameter(f'lower_um {axis}', lower, f'less than upper_um, {upper:g}')
            if not lower <= home <= upper:
                raise InvalidParameter(f'home_um {axis}', home, f'{lower:g} to {upper:g}')

    @property
    def limits(self) -> StageLimits:
        """What the stage can do."""
        return StageLimits(self.base_um, self.lower_um, self.upper_um, self.max_velocity_um_s)


@dataclass(frozen=True)
class Motion:
    """How fast the station moves.

    Parameters
    ----------
    roll_rate_deg_s : float
        Largest rate at which the object is turned [deg/s].
    travel_um_s : float
        Largest speed of a tip while a plan is executed [µm/s].
    transit_um_s : float
        Largest speed of a tip on the way to the start of a plan [µm/s].
    speed : float
        Scales these three, and how fast they are reached.
    """

    roll_rate_deg_s: float = 90.0
    travel_um_s: float = 100.0
    transit_um_s: float = 200.0
    speed: float = 1.0

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_number('roll_rate_deg_s', self.roll_rate_deg_s, low=0.0, high=3600.0, low_open=True)
        check_number('travel_um_s', self.travel_um_s, low=0.0, high=1e6, low_open=True)
        check_number('transit_um_s', self.transit_um_s, low=0.0, high=1e6, low_open=True)
        check_number('speed', self.speed, low=0.01, high=20.0)

    def pace(self, axis_um_s: float) -> Pace:
        """Return the pace of plans on stages of this velocity limit."""
        return Pace(
            roll_rate_rad_s=math.radians(self.roll_rate_deg_s) * self.speed,
            travel_um_s=self.travel_um_s * self.speed,
            axis_um_s=axis_um_s,
            acceleration_um_s2=Pace.acceleration_um_s2 * self.speed**2,
            jerk_um_s3=Pace.jerk_um_s3 * self.speed**3,
        )

    def transit_pace(self, axis_um_s: float) -> Pace:
        """Return the pace on the way to the start of a plan."""
        return dataclasses.replace(
            self.pace(axis_um_s), travel_um_s=self.transit_um_s * self.speed
        )


@dataclass(frozen=True)
class StationConfig:
    """A station: three fingers, how they move and touch, and the record of what they do.

    Parameters
    ----------
    namespace : str
        Of all names; empty: none.
    frame : str
        Frame of tips and poses.
    motion : Motion
        How fast.
    contact : ContactConfig
        How fingers meet the object.
    tolerances : ToleranceConfig
        How far stages may be from where they should be.
    twin : TwinConfig
        What stands in for the object.
    recording : RecordingConfig
        What is kept of runs.
    fingers : tuple of 3 FingerConfig
        Fingers 1, 2, 3.
    """

    namespace: str = ''
    frame: str = 'station'
    motion: Motion = field(default_factory=Motion)
    contact: ContactConfig = field(default_factory=ContactConfig)
    tolerances: ToleranceConfig = field(default_factory=ToleranceConfig)
    twin: TwinConfig = field(default_factory=TwinConfig)
    recording: RecordingConfig = field(default_factory=RecordingConfig)
    fingers: tuple[FingerConfig, ...] = (
        FingerConfig(home_um=(170.0, 100.0, 100.0)),
        FingerConfig(home_um=(30.0, 100.0, 100.0)),
        FingerConfig(home_um=(100.0, 100.0, 170.0)),
    )

    def __post_init__(self) -> None:
        """Check names and the number of fingers."""
        if not NAMESPACE.match(self.namespace):
            raise BadRequest('namespace', repr(self.namespace), 'a ROS name, or empty')
        if not NAME.match(self.frame):
            raise BadRequest('frame', repr(self.frame), 'a name of letters, digits and _')
        if len(self.fingers) != FINGERS:
            raise BadRequest('fingers', f'a list of {len(self.fingers)}', f'a list of {FINGERS}')

    @property
    def stiffness_uN_per_um(self) -> Vector:
        """Of fingers 1, 2, 3: µN/µm is N/m."""
        first, second, third = (finger.stiffness_n_per_m for finger in self.fingers)
        return first, second, third

    @property
    def touch(self) -> Touch:
        """How fingers meet the object."""
        return self.contact.touch(max(self.stiffness_uN_per_um))

    def to_dict(self) -> dict[str, Any]:
        """Return the content of the station file that describes this station."""
        return {
            'namespace': self.namespace,
            'frame': self.frame,
            'motion': dataclasses.asdict(self.motion),
            'contact': dataclasses.asdict(self.contact),
            'tolerances': dataclasses.asdict(self.tolerances),
            'twin': dataclasses.asdict(self.twin),
            'recording': dataclasses.asdict(self.recording),
            'fingers': [
                {
                    key: list(value) if isinstance(value, tuple) else value
                    for key, value in vars(finger).items()
                }
                for finger in self.fingers
            ],
        }


def read_config(path: Path) -> StationConfig:
    """Read a station file.

    Raises
    ------
    BadRequest
        The file cannot be read, or a key is unknown or has a wrong value; the message names the
        file, the key and what is allowed.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise BadRequest('config', f'{path} ({error.strerror})', 'a readable file') from error
    except yaml.YAMLError as error:
        reason = ' '.join(str(error).split())
        raise BadRequest('config', f'{path} ({reason})', 'a YAML file') from error
    try:
        return config_from_dict({} if content is None else content)
    except BadRequest as error:
        raise type(error)(f'{path}: {error.field}', error.value, error.allowed) from error


def write_config(config: StationConfig, path: Path) -> None:
    """Write a station file that `read_config` reads back."""
    path.write_text(yaml.safe_dump(config.to_dict(), sort_keys=False), encoding='utf-8')


def config_from_dict(content: object) -> StationConfig:
    """Return the station that the content of a station file describes.

    Raises
    ------
    BadRequest
        Names the key at fault, its value and what is allowed.
    """
    default = StationConfig()
    top = _section(
        'station',
        content,
        ('namespace', 'frame', 'motion', 'contact', 'tolerances', 'twin', 'recording', 'fingers'),
    )
    motion = _section('motion', top.get('motion', {}), tuple(vars(default.motion)))
    contact = _section('contact', top.get('contact', {}), tuple(vars(default.contact)))
    tolerances = _section('tolerances', top.get('tolerances', {}), tuple(vars(default.tolerances)))
    fingers = top.get('fingers', [{}] * FINGERS)
    if not isinstance(fingers, list) or len(fingers) != FINGERS:
        raise BadRequest('fingers', _shown(fingers), f'a list of {FINGERS}')
    return StationConfig(
        namespace=_text('namespace', top.get('namespace', default.namespace)),
        frame=_text('frame', top.get('frame', default.frame)),
        motion=Motion(**_numbers('motion', motion)),
        contact=_named(
            'contact', lambda: ContactConfig(**_numbers('contact', contact, ('speed_um_s',)))
        ),
        tolerances=_named(
            'tolerances', lambda: ToleranceConfig(**_numbers('tolerances', tolerances))
        ),
        twin=_named('twin', lambda: _twin(top.get('twin', {}))),
        recording=_named('recording', lambda: _recording(top.get('recording', {}))),
        fingers=tuple(
            _finger(number, finger, default.fingers[number - 1])
            for number, finger in enumerate(fingers, start=1)
        ),
    )


def _finger(number: int, content: object, default: FingerConfig) -> FingerConfig:
    """Return one finger; keys that are left out keep their defaults."""
    name = f'finger {number}'
    given = dict(_section(name, content, tuple(vars(default))))
    for key in given.keys() - {'driver'}:
        label = f'{name}: {key}'
        read = _vector if isinstance(getattr(default, key), tuple) else _number
        given[key] = read(label, given[key])
    if 'driver' in given and not isinstance(given['driver'], dict):
        raise BadRequest(f'{name}: driver', _shown(given['driver']), 'names and values')
    return _named(name, lambda: dataclasses.replace(default, **given))


def _twin(content: object) -> TwinConfig:
    """Return what the twin takes to be true; null leaves it to the plan."""
    given = dict(_section('twin', content, tuple(vars(TwinConfig()))))
    enabled = given.pop('enabled', True)
    if not isinstance(enabled, bool):
        raise BadRequest('enabled', _shown(enabled), 'true or false')
    return TwinConfig(enabled=enabled, **_numbers('twin', given, ('friction', 'pull_off_uN')))


def _recording(content: object) -> RecordingConfig:
    """Return what is kept of runs."""
    given = dict(_section('recording', content, tuple(vars(RecordingConfig()))))
    if 'max_message_mb' in given:
        given['max_message_mb'] = _number('max_message_mb', given['max_message_mb'])
    return RecordingConfig(**given)


def _named(section: str, make: Callable[[], Made]) -> Made:
    """Make a value; what is wrong with it is said of its section."""
    try:
        return make()
    except BadRequest as error:
        if error.field.startswith(f'{section}: '):
            raise
        raise type(error)(f'{section}: {error.field}', error.value, error.allowed) from error


def _numbers(
    section: str, content: Mapping[str, Any], may_be_null: Sequence[str] = ()
) -> dict[str, float]:
    """Return the numbers of a section; null, where it is allowed, is as good as nothing."""
    return {
        key: _number(f'{section}: {key}', value)
        for key, value in content.items()
        if value is not None or key not in may_be_null
    }


def _section(name: str, content: object, allowed: tuple[str, ...]) -> Mapping[str, Any]:
    """Return a mapping, all of whose keys are allowed."""
    if not isinstance(content, dict):
        raise BadRequest(name, _shown(content), f'a section with {", ".join(allowed)}')
    for key in content:
        if key not in allowed:
            raise BadRequest(f'{name}: {key}', 'unknown', ', '.join(allowed))
    return content


def _number(name: str, value: object) -> float:
    """Return a number; an integer is one, a boolean is not."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise BadRequest(name, _shown(value), 'a number')
    return check_number(name, float(value))


def _vector(name: str, value: object) -> Vector:
    """Return three numbers."""
    if not isinstance(value, list) or len(value) != len(AXES):
        raise BadRequest(name, _shown(value), 'three numbers x y z')
    x, y, z = (_number(f'{name} {axis}', number) for axis, number in zip(AXES, value, strict=True))
    return x, y, z


def _text(name: str, value: object) -> str:
    """Return a text."""
    if not isinstance(value, str):
        raise BadRequest(name, _shown(value), 'a text')
    return value


def _shown(value: object) -> str:
    """Return a value as an error message shows it: short."""
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + '...'
