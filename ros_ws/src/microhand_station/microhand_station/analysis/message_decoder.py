# SPDX-License-Identifier: Apache-2.0
"""Records of an mcap file → decoded messages, without ROS; damaged ones are passed over."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import redirect_stderr
from dataclasses import dataclass
from io import StringIO
from typing import Any

from mcap.records import Channel, McapRecord, Message, Schema
from mcap_ros2.decoder import DecoderFactory


@dataclass(frozen=True)
class RecordedTopic:
    """A topic of a record.

    Attributes
    ----------
    name : str
        With its namespace.
    type_name : str
        ``package/msg/Type``; empty: its schema is missing.
    schema : str
        Definition of the type and of all types that it uses, with comments; empty: missing.
    offered_qos : str
        QoS of its publishers, YAML as rosbag2 writes it.
    """

    name: str
    type_name: str
    schema: str
    offered_qos: str


class MessageDecoder:
    """Knows the topics of one file, and decodes its messages.

    Attributes
    ----------
    topics : dict
        Topics announced so far, by name.
    """

    def __init__(self) -> None:
        self.topics: dict[str, RecordedTopic] = {}
        self._factory = DecoderFactory()
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._decoders: dict[int, Callable[[bytes], Any] | None] = {}

    def announce(self, record: McapRecord) -> None:
        """Take in a schema or a channel; other records tell nothing about topics."""
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            schema = self._schemas.get(record.schema_id)
            self._channels[record.id] = record
            self.topics[record.topic] = RecordedTopic(
                name=record.topic,
                type_name='' if schema is None else schema.name,
                schema='' if schema is None else schema.data.decode('utf-8', 'replace'),
                offered_qos=record.metadata.get('offered_qos_profiles', ''),
            )

    def topic_of(self, message: Message) -> RecordedTopic | None:
        """Return the topic of a message; None: its channel was not announced."""
        channel = self._channels.get(message.channel_id)
        return None if channel is None else self.topics[channel.topic]

    def decode(self, message: Message) -> Any | None:
        """Return the message as an object with its fields; None: it cannot be decoded."""
        # Damaged bytes surface as whatever the decoder stumbles over.
        try:
            decoder = self._decoder(message.channel_id)
            return None if decoder is None else decoder(message.data)
        except Exception:
            return None

    def _decoder(self, channel_id: int) -> Callable[[bytes], Any] | None:
        """Return the decoder of a channel; None if its schema is missing or damaged."""
        if channel_id not in self._decoders:
            channel = self._channels[channel_id]
            schema = self._schemas.get(channel.schema_id)
            with redirect_stderr(StringIO()):  # the parser of schemas prints what it stumbles over
                try:
                    decoder = self._factory.decoder_for(channel.message_encoding, schema)
                except Exception:
                    decoder = None
            self._decoders[channel_id] = decoder
        return self._decoders[channel_id]
