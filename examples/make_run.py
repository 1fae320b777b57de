# SPDX-License-Identifier: Apache-2.0
"""Make `reorientation.mcap`, the run that is shipped: the paper's reorientation in simulation.

    .venv/bin/python examples/make_run.py             # runs a station for half a minute
    .venv/bin/python examples/make_run.py RUN.mcap    # takes a run that there is

Without log, diagnostics and places of files, which tell of the machine rather than of the run.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer

from microhand_station.analysis.message_decoder import MessageDecoder
from microhand_station.recording.record_scan import scan_records
from microhand_station.recording.run_writer import PARAMETERS_METADATA, VERSIONS_METADATA

EXAMPLE = Path(__file__).with_name('reorientation.mcap')
LEFT_OUT = ('/rosout', '/diagnostics', '/parameter_events')
PLACES = ('run_dir', 'config')
"""Parameters of nodes that are paths."""


def record() -> Path:
    """Run the demonstration; return its record."""
    folder = tempfile.mkdtemp()
    command = [sys.executable, '-m', 'microhand_station.cli.app', 'demo', '--run-dir', folder]
    done = subprocess.run([*command, '--json'], stdout=subprocess.PIPE, check=True, text=True)
    return Path(json.loads(done.stdout)['mcap'])


def without_machine(found: Metadata) -> dict[str, str]:
    """Return what a metadata record says of the run."""
    if found.name == VERSIONS_METADATA:
        return {name: text for name, text in found.metadata.items() if name != 'system'}
    if found.name != PARAMETERS_METADATA:
        return found.metadata
    nodes = {node: json.loads(text) for node, text in found.metadata.items()}
    return {
        node: json.dumps({name: value for name, value in values.items() if name not in PLACES})
        for node, values in nodes.items()
    }


def ship(source: Path, target: Path) -> int:
    """Copy a record, compressed; return how many messages are in it."""
    decoder, schemas, channels, count = MessageDecoder(), {0: 0}, {}, 0
    with target.open('wb') as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile='ros2', library='microhand')
        for found in scan_records(source):
            if isinstance(found, Schema | Channel):
                decoder.announce(found)
            if isinstance(found, Schema) and found.id not in schemas:
                schemas[found.id] = writer.register_schema(found.name, found.encoding, found.data)
            elif isinstance(found, Channel) and found.topic not in LEFT_OUT:
                channels.setdefault(
                    found.id,
                    writer.register_channel(
                        found.topic,
                        found.message_encoding,
                        schemas[found.schema_id],
                        found.metadata,
                    ),
                )
            elif isinstance(found, Metadata):
                writer.add_metadata(found.name, without_machine(found))
            elif isinstance(found, Attachment):
                writer.add_attachment(
                    found.create_time, found.log_time, found.name, found.media_type, found.data
                )
            elif isinstance(found, Message) and found.channel_id in channels:
                if getattr(decoder.decode(found), 'text', '').startswith('recording '):
                    continue
                writer.add_message(
                    channels[found.channel_id],
                    found.log_time,
                    found.data,
                    found.publish_time,
                    found.sequence,
                )
                count += 1
        writer.finish()
    return count


if __name__ == '__main__':
    run = Path(sys.argv[1]) if len(sys.argv) > 1 else record()
    print(f'{ship(run, EXAMPLE)} messages in {EXAMPLE}, {EXAMPLE.stat().st_size / 1e6:.1f} MB')
