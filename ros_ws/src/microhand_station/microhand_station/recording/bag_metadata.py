# SPDX-License-Identifier: Apache-2.0
"""A finished record → the ``metadata.yaml`` beside it that makes its folder a bag of rosbag2.

Version 9 of the format, that of Jazzy: `rosbag2_storage/yaml.hpp` says which keys there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from microhand_station.recording.run_writer import RunWriter

METADATA_FILE = 'metadata.yaml'


@dataclass(frozen=True)
class AnnouncedTopic:
    """A topic as it is announced in a record.

    Attributes
    ----------
    name : str
        With its namespace.
    type_name : str
        ``package/msg/Type``.
    schema : str
        Of `ros2msg_schema`.
    offered_qos : str
        QoS of its publishers, in the YAML of rosbag2.
    type_hash : str
        As ROS computes it; empty: unknown.
    """

    name: str
    type_name: str
    schema: str
    offered_qos: str
    type_hash: str


def write_bag_metadata(record: Path, writer: RunWriter, topics: Sequence[AnnouncedTopic]) -> None:
    """Write ``metadata.yaml`` beside a record.

    Parameters
    ----------
    record : Path
        The mcap file, alone in its folder.
    writer : RunWriter
        Has written it.
    topics : sequence of AnnouncedTopic
        All that are announced in it.

    Raises
    ------
    OSError
        The disk refuses.
    """
    information = {
        'version': 9,
        'storage_identifier': 'mcap',
        **_span(writer),
        'topics_with_message_count': [
            {'topic_metadata': _topic(topic), 'message_count': writer.counts[topic.name]}
            for topic in topics
        ],
        # of the bag as a whole; an mcap file compresses its own chunks
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': [record.name],
        'files': [{'path': record.name, **_span(writer)}],
        'custom_data': None,
        'ros_distro': 'jazzy',
    }
    text = yaml.safe_dump({'rosbag2_bagfile_information': information}, sort_keys=False)
    (record.parent / METADATA_FILE).write_text(text, encoding='utf-8')


def _span(writer: RunWriter) -> dict[str, Any]:
    """Return from when to when, and how many messages: made anew, or YAML would refer back."""
    return {
        'starting_time': {'nanoseconds_since_epoch': writer.start_ns},
        'duration': {'nanoseconds': writer.end_ns - writer.start_ns},
        'message_count': writer.messages,
    }


def _topic(topic: AnnouncedTopic) -> dict[str, Any]:
    """Return what is said of a topic."""
    return {
        'name': topic.name,
        'type': topic.type_name,
        'serialization_format': 'cdr',
        'offered_qos_profiles': yaml.safe_load(topic.offered_qos),
        'type_description_hash': topic.type_hash,
    }
