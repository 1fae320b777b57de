# SPDX-License-Identifier: Apache-2.0
"""Lines and replies of GCS 2.0, cut wherever the network cuts them."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stage_driver_sim.errors import InvalidParameter, StageSilent
from stage_driver_sim.gcs.connection import parse_address
from stage_driver_sim.gcs.syntax import (
    LONGEST_LINE,
    LONGEST_REPLY,
    STOP,
    CommandSplitter,
    ReplySplitter,
    axis_values,
    command_line,
    reply_lines,
)

TALK = b'SVO 1 1 2 1\nMOV 1 10.5\x18 2 -3\n\nPOS?\n'
COMMANDS = ['SVO 1 1 2 1', STOP, 'MOV 1 10.5 2 -3', '', 'POS?']
ANSWER = b'1=10.5 \n2=-3.0 \n3=1e-05\n(c)someone, E-1, 7, 1.0\n0\n'
REPLIES = [['1=10.5', '2=-3.0', '3=1e-05'], ['(c)someone, E-1, 7, 1.0'], ['0']]


def pieces(data: bytes, cuts: list[int]) -> list[bytes]:
    """Return `data` cut at the given places."""
    places = [0, *sorted(cuts), len(data)]
    return [data[a:b] for a, b in pairwise(places)]


@given(cuts=st.lists(st.integers(0, len(TALK)), max_size=8))
def test_commands_are_the_same_however_they_arrive(cuts: list[int]) -> None:
    """Any way of cutting the bytes gives the same commands; #24 counts inside a line, too."""
    splitter = CommandSplitter()
    found = [command for piece in pieces(TALK, cuts) for command in splitter.feed(piece)]
    assert sorted(found) == sorted(COMMANDS)
    assert found.index(STOP) < found.index('MOV 1 10.5 2 -3')


@given(cuts=st.lists(st.integers(0, len(ANSWER)), max_size=8))
def test_replies_are_the_same_however_they_arrive(cuts: list[int]) -> None:
    """Any way of cutting the bytes gives the same replies, and nothing is left over."""
    splitter = ReplySplitter()
    found = [reply for piece in pieces(ANSWER, cuts) for reply in splitter.feed(piece)]
    assert found == REPLIES
    assert splitter.empty


@given(lines=st.lists(st.from_regex(r'[1-9]=-?[0-9]{1,5}\.[0-9]{6}', fullmatch=True), min_size=1))
def test_a_reply_is_read_as_it_was_written(lines: list[str]) -> None:
    """What one side writes, the other reads."""
    assert ReplySplitter().feed(reply_lines(*lines)) == [lines]


def test_an_endless_line_or_reply_does_not_fill_the_memory() -> None:
    """A controller cuts a line that is too long; a client gives up on a reply without end."""
    splitter = CommandSplitter()
    for _ in range(100):
        assert splitter.feed(b'x' * 1000) == []
    (line,) = splitter.feed(b'\n')
    assert len(line) == LONGEST_LINE + 1
    replies = ReplySplitter()
    assert replies.feed(b'1=0.0 \n' * 100) == []
    with pytest.raises(StageSilent, match=f'longer than {LONGEST_REPLY}'):
        replies.feed(b'1=0.0 \n' * 900)


def test_numbers_are_written_to_the_picometre() -> None:
    """Six decimals of a micrometre; the mnemonic is followed by axes and values."""
    assert command_line('MOV', '1', 1.0 / 3.0, '2', -0.0000004) == b'MOV 1 0.333333 2 -0.000000\n'


@pytest.mark.parametrize(
    'reply',
    [
        ['1=1.0', '2=2.0'],
        ['1=1.0', '2=2.0', '4=3.0'],
        ['1=1.0', '3=3.0', '2=2.0'],
        ['1=1.0', '2=nan', '3=3.0'],
        ['1=1.0', '2=inf', '3=3.0'],
        ['1=1.0', '2=', '3=3.0'],
        ['1=1.0', '2', '3=3.0'],
        ['\x00\xff', '', ''],
        [],
    ],
    ids=['missing', 'other', 'order', 'nan', 'inf', 'empty', 'cut', 'garbage', 'nothing'],
)
def test_a_reply_that_makes_no_sense_is_no_answer(reply: list[str]) -> None:
    """Only one finite number for each axis that was asked for counts; the query is named."""
    with pytest.raises(
        StageSilent, match=r'POS\? was answered .*allowed: <axis>=<number> for 1 2'
    ):
        axis_values('POS?', reply, ['1', '2', '3'])


@pytest.mark.parametrize('text', ['', 'host:', 'host:0', 'host:65536', 'a b', ':50000', 'h:1:2'])
def test_addresses_that_are_none_are_refused(text: str) -> None:
    """Host and port, or a host alone; anything else is named."""
    with pytest.raises(InvalidParameter, match=r'gcs_address is .*allowed: host:port'):
        parse_address(text)
