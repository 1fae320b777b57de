# SPDX-License-Identifier: Apache-2.0
"""The files that people write and read: keys, ranges and defaults as the code has them."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterator, Mapping
from typing import Any
from unittest import mock

from docstring_fields import docstring_fields
from markdown_table import code, markdown_table
from scipy.spatial.transform import Rotation

from microhand_planner.core import hold, parameters, plan, pose
from microhand_planner.core.catalogue import find_part
from microhand_planner.core.plan_file import plan_to_dict
from microhand_planner.core.planner import plan_reorientation
from microhand_station import config, contact_config, recording_config

SECTIONS = {
    '': (config.StationConfig(), ('namespace', 'frame')),
    'motion': (config.Motion(), None),
    'contact': (contact_config.ContactConfig(), None),
    'twin': (contact_config.TwinConfig(), None),
    'recording': (recording_config.RecordingConfig(), None),
    'fingers: -': (config.FingerConfig(), None),
}
CHOICES = {'on_failure': f'`{recording_config.STOP}` or `{recording_config.GO_ON}`'}
YAML = {'None': '`null`', 'False': '`false`', 'True': '`true`'}
ENUMS = {'StepKind': plan.StepKind, 'Mode': parameters.Mode}
ASKED = {'speed_um_s': 1.0, 'friction': 0.3, 'pull_off_uN': 1.5}
"""Values for what is None by default, so that it is checked."""


def station_file() -> str:
    """Return the keys of a station file, section by section."""
    parts = []
    for section, (default, keys) in SECTIONS.items():
        ranges = _ranges(default)
        about = docstring_fields(type(default))
        rows = [
            (
                code(key),
                code(_value(value)),
                CHOICES.get(key) or ranges.get(key, _kind(value)),
                _as_yaml(about[key][1]),
            )
            for key, value in vars(default).items()
            if keys is None or key in keys
        ]
        parts.append(f'## `{section}`\n' if section else '## At the top\n')
        parts.append(markdown_table(('key', 'default', 'allowed', 'meaning'), rows))
    return '\n'.join(parts)


def _as_yaml(text: str) -> str:
    """Return a docstring's text with the names of YAML: null for None."""
    return re.sub(r'\b(None|False|True)(?=:)', lambda word: YAML[word[0]], text)


def _ranges(default: Any) -> dict[str, str]:
    """Return what is allowed for each number, by looking on while a value is checked."""
    found: dict[str, str] = {}

    def look_on(field: str, value: float, **limits: Any) -> float:
        found[field] = _allowed(**limits)
        return value

    given = {key: value for key, value in ASKED.items() if key in vars(default)}
    with (
        mock.patch.object(config, 'check_number', look_on),
        mock.patch.object(contact_config, 'check_number', look_on),
        mock.patch.object(recording_config, 'check_number', look_on),
    ):
        dataclasses.replace(default, **given)
    return found


def _allowed(low: float = -math.inf, high: float = math.inf, low_open: bool = False) -> str:
    above = f'{"more than" if low_open else "from"} {low:g}'
    return f'{above} to {high:g}' if math.isfinite(high) else above


def _kind(value: object) -> str:
    if isinstance(value, bool):
        return 'true or false'
    if isinstance(value, tuple):
        return 'three numbers'
    if isinstance(value, Mapping):
        return 'names and values'
    return {str: 'a text', float: 'a number'}.get(type(value), '')


def _value(value: object) -> str:
    """Return a value as YAML and JSON write it."""
    if value is None:
        return 'null'
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f'{value:.6g}'
    if isinstance(value, tuple | list):
        return '[' + ', '.join(_value(one) for one in value) + ']'
    return "''" if value == '' else str(value)


DOCUMENTED = {
    '': plan.Plan,
    'start': pose.Pose,
    'goal': pose.Pose,
    'finger': parameters.Finger,
    'law': parameters.ContactLaw,
    'options': parameters.SearchOptions,
    'rules': parameters.GripRules,
    'rotations': plan.RotationReport,
    'steps': plan.Step,
    'steps: hold': hold.Hold,
}
FILE_ONLY = {
    'format_version': ('text', 'Of this layout; readers refuse another major version.'),
    'plan_hash': (
        'text',
        'sha256 of everything but times and effort; refused if it does not fit.',
    ),
    'object: name': ('text', 'Catalogue name or file name.'),
    'object: sha256': ('text', 'Of vertices and faces of the part.'),
}


def plan_file() -> str:
    """Return the keys of a plan file; the example is planned here and now."""
    goal = pose.Pose.of((0.0, 0.0, 0.0), Rotation.from_euler('ZYZ', [0, 40, 0], degrees=True))
    made = plan_reorientation(
        find_part('ellipsoid'),
        pose.Pose(),
        goal,
        parameters.Finger(),
        parameters.ContactLaw(),
        parameters.SearchOptions(),
    )
    rows = [
        (code(key), kind, meaning)
        for key, kind, meaning in _keys('', plan_to_dict(made), DOCUMENTED[''])
    ]
    return markdown_table(('key', 'type', 'meaning'), rows)


def _keys(
    where: str, content: Mapping[str, Any], documented: type | None
) -> Iterator[tuple[str, str, str]]:
    """Give key, type and meaning of what is in a mapping, and of what is in that."""
    about = docstring_fields(documented) if documented else {}
    for name, value in content.items():
        path = f'{where}: {name}' if where else name
        inner = next((one for one in value if one), None) if isinstance(value, list) else value
        if path == 'steps':  # one that has all there is
            inner = next(step for step in value if step['hold'])
        if isinstance(inner, dict):
            text = _as_yaml(about.get(name, ('', 'The part that the plan was made for.'))[1])
            yield path, 'list' if isinstance(value, list) else 'object', text
            yield from _keys(path, inner, DOCUMENTED.get(path))
            continue
        kind, text = FILE_ONLY.get(path) or about.get(name) or about[_in_radians(name)]
        kinds = ENUMS.get(kind)
        if kinds:
            kind = ', '.join(f'`{one.value}`' for one in kinds)
        yield path, kind.removesuffix(', optional'), _as_yaml(text).replace('[rad]', '[deg]')


def _in_radians(name: str) -> str:
    """Return the name in the core of what is in degrees in the file."""
    return name.replace('_deg', '_rad')
