# SPDX-License-Identifier: Apache-2.0
"""The syntax of GCS 2.0: lines of commands, replies of one or several lines.

From the manual of the C-863 ([MS249E]_, sections 8.1 and 8.2):

- A command is a mnemonic of three letters, a query has a ``?`` behind it; ``*IDN?`` is the
  exception. Mnemonic and arguments are separated by spaces; the line ends with LF. Upper and lower
  case are the same.
- Commands of one character, such as #24 (stop), have no LF, and interrupt a line.
- A reply is one line ``value`` or ``argument=value`` per argument, in the order of the query.
  Every line but the last has a space before its LF: so the end of a reply can be told.

References
----------
.. [MS249E] PI, C-863.12 user manual MS249E 1.2.1, pp. 115-117,
   https://www.easymanua.ls/pi/ms249e/manual?p=121,
   https://manualshive.com/ru/manual/pi/ms249e/1554329?page=122
"""

from __future__ import annotations

from collections.abc import Sequence

from stage_driver_sim.errors import StageSilent

STOP = '\x18'
"""#24: stop all axes."""
MOTION = '\x05'
"""#5: which axes move."""
READY = '\x07'
"""#7: whether the controller takes commands."""
SINGLE = (STOP, MOTION, READY)

LONGEST_LINE = 256
LONGEST_REPLY = 4096


def command_line(mnemonic: str, *arguments: str | float) -> bytes:
    r"""Return a command with its arguments; numbers get six decimals (µm: picometres).

    Examples
    --------
    >>> command_line('MOV', '1', 10.0, '2', 2.5)
    b'MOV 1 10.000000 2 2.500000\n'
    """
    words = [mnemonic, *(x if isinstance(x, str) else f'{x:.6f}' for x in arguments)]
    return ' '.join(words).encode('ascii') + b'\n'


def reply_lines(*lines: str) -> bytes:
    r"""Return a reply.

    Examples
    --------
    >>> reply_lines('1=10.5', '2=-0.25')
    b'1=10.5 \n2=-0.25\n'
    """
    return ' \n'.join(lines).encode('latin-1') + b'\n'


class CommandSplitter:
    """Bytes as they arrive at a controller → commands."""

    def __init__(self) -> None:
        self._line = ''

    def feed(self, data: bytes) -> list[str]:
        r"""Return the commands that are complete now, without LF.

        A line that is too long comes as one that no controller knows.

        Examples
        --------
        >>> splitter = CommandSplitter()
        >>> splitter.feed(b'MOV 1 1')
        []
        >>> splitter.feed(b'0\x18.5\nPOS?\n')
        ['\x18', 'MOV 1 10.5', 'POS?']
        """
        commands = []
        for character in data.decode('latin-1'):
            if character in SINGLE:
                commands.append(character)
            elif character == '\n':
                commands.append(self._line.strip())
                self._line = ''
            elif len(self._line) <= LONGEST_LINE:
                self._line += character
        return commands


class ReplySplitter:
    """Bytes as they arrive from a controller → replies."""

    def __init__(self) -> None:
        self._text = ''
        self._lines: list[str] = []

    @property
    def empty(self) -> bool:
        """True: nothing is left over."""
        return not self._text and not self._lines

    def feed(self, data: bytes) -> list[list[str]]:
        r"""Return the replies that are complete now, each as lines without spaces at the end.

        Raises
        ------
        StageSilent
            A reply that does not end.

        Examples
        --------
        >>> splitter = ReplySplitter()
        >>> splitter.feed(b'1=10.5 \n2=-0')
        []
        >>> splitter.feed(b'.25\n2.0\n')
        [['1=10.5', '2=-0.25'], ['2.0']]
        """
        *complete, self._text = (self._text + data.decode('latin-1')).split('\n')
        replies = []
        for line in complete:
            self._lines.append(line.strip())
            if not line.endswith(' '):
                replies.append(self._lines)
                self._lines = []
        if len(self._text) + sum(len(line) + 2 for line in self._lines) > LONGEST_REPLY:
            raise StageSilent(f'a reply is longer than {LONGEST_REPLY} characters')
        return replies


def axis_values(query: str, reply: Sequence[str], axes: Sequence[str]) -> list[float]:
    """Return the numbers of a reply, one per axis that was asked for, in that order.

    Raises
    ------
    StageSilent
        The reply is not ``axis=number`` for each axis.

    Examples
    --------
    >>> axis_values('POS?', ['1=10.5', '2=-0.25'], ['1', '2'])
    [10.5, -0.25]
    """
    values = []
    pairs = [line.partition('=') for line in reply]
    if [axis.strip() for axis, _, _ in pairs] == list(axes):
        for _, _, text in pairs:
            try:
                values.append(float(text))
            except ValueError:
                break
    # A number that is none would go on into positions and commands.
    if len(values) != len(axes) or any(abs(x) > 1e9 or x != x for x in values):
        shown = '; '.join(reply)
        raise StageSilent(
            f'{query} was answered {shown[:80]!r}; allowed: <axis>=<number> for {" ".join(axes)}'
        )
    return values
