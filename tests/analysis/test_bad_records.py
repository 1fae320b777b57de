# SPDX-License-Identifier: Apache-2.0
"""Files that are no record, or no longer one: a clear line, or a page that says what it lacks."""

import random

import pytest
from mcap.writer import Writer

from microhand_station.cli.app import main
from microhand_station.recording.recover import recover


def foreign(path):
    """Write an mcap file of something else."""
    with path.open('xb') as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema('camera/Image', 'jsonschema', b'{}')
        channel = writer.register_channel('/camera', 'json', schema)
        writer.add_message(channel, 0, b'{"a": 1}', 0)
        writer.finish()
    return path


@pytest.fixture
def bad(tmp_path, record):
    """Return files that are no records, by what is wrong with them."""
    contents = {
        'empty': b'',
        'text': b'solid ellipsoid\n',
        'magic alone': b'\x89MCAP0\r\n',
        'head alone': record.read_bytes()[:60],
    }
    paths = {}
    for name, content in contents.items():
        paths[name] = tmp_path / f'{name.replace(" ", "_")}.mcap'
        paths[name].write_bytes(content)
    paths['foreign'] = foreign(tmp_path / 'foreign.mcap')
    paths['missing'] = tmp_path / 'missing.mcap'
    paths['a folder'] = tmp_path
    return paths


@pytest.mark.parametrize(
    ('kind', 'says'),
    [
        ('empty', 'this one is empty'),
        ('text', 'this one starts otherwise'),
        ('magic alone', 'this one has 0 topics, none of microhand'),
        ('head alone', 'this one has 0 topics, none of microhand'),
        ('foreign', 'this one has 1 topics, none of microhand'),
        ('missing', 'No such file'),
        ('a folder', 'Is a directory'),
    ],
)
def test_what_is_no_record_is_one_clear_line(bad, tmp_path, capsys, kind, says):
    """`microhand analyze` names the file and what it should be; exit status 2, no page."""
    page = tmp_path / 'page.html'
    assert main(['analyze', str(bad[kind]), '-o', str(page)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f'microhand: record is {bad[kind]}; allowed: ')
    assert says in error
    assert error.count('\n') == 1
    assert not page.exists()


@pytest.mark.parametrize('kind', ['empty', 'text', 'magic alone', 'missing'])
@pytest.mark.parametrize('command', ['export', 'replay'])
def test_other_commands_refuse_it_as_well(bad, tmp_path, capsys, kind, command):
    """One line, exit status 2."""
    more = ['--csv', str(tmp_path / 'csv')] if command == 'export' else []
    assert main([command, str(bad[kind]), *more]) == 2
    error = capsys.readouterr().err
    assert error.startswith('microhand: record is ')
    assert error.count('\n') == 1


def test_a_record_cut_anywhere_gives_a_page_or_a_line(record, tmp_path, capsys):
    """Cut at twelve places, from the first topic to the last message: never a traceback."""
    data = record.read_bytes()
    cut, page = tmp_path / 'cut.mcap', tmp_path / 'cut.html'
    for part in range(1, 13):
        cut.write_bytes(data[: len(data) * part // 13])
        status = main(['analyze', str(cut), '-o', str(page)])
        assert status == 0, capsys.readouterr().err
        assert 'The record was not finished' in page.read_text(encoding='utf-8')


def test_damaged_records_never_end_in_a_traceback(record, tmp_path, capsys):
    """Random bytes flipped (seed 5), also in definitions, plan and chunks: a page, or one line."""
    data = record.read_bytes()
    # the definitions, the plan, and some of each topic: what is damaged counts, not how much
    cut, packed = tmp_path / 'cut.mcap', tmp_path / 'packed.mcap'
    cut.write_bytes(data[: len(data) // 4])
    recover(cut, packed)
    draw = random.Random(5)
    bad, page = tmp_path / 'bad.mcap', tmp_path / 'bad.html'
    pages = 0
    for round_ in range(16):
        damaged = bytearray((packed if round_ % 4 == 3 else cut).read_bytes())
        last = len(damaged) if round_ % 2 else 60_000
        for _ in range(draw.choice((1, 20, 300))):
            damaged[draw.randrange(8, last)] = draw.randrange(256)
        bad.write_bytes(damaged)
        status = main(['analyze', str(bad), '-o', str(page)])
        error = capsys.readouterr().err
        assert status in (0, 2), error
        assert 'unforeseen' not in error
        pages += status == 0
        folder = tmp_path / f'csv{round_}'
        assert main(['export', str(bad), '--csv', str(folder)]) in (0, 2)
        assert 'unforeseen' not in capsys.readouterr().err
    assert pages >= 12


def test_a_run_without_an_object_has_a_page_that_says_so(made, tmp_path, capsys):
    """A real station without a twin: positions are there, the verdict is that nobody judged."""
    record, page = tmp_path / 'r.mcap', tmp_path / 'r.html'
    made.write(record, chosen=lambda name: 'object' not in name)
    assert main(['analyze', str(record), '-o', str(page)]) == 0
    text = page.read_text(encoding='utf-8')
    assert 'whether the object was held was not judged' in text
    assert 'Nothing watched the object' in text
    assert 'The plan was executed' in capsys.readouterr().out
