# SPDX-License-Identifier: Apache-2.0
"""What a station keeps of its runs, and what becomes of a run whose record fails."""

from __future__ import annotations

from dataclasses import dataclass

from microhand_planner.core.errors import InvalidParameter
from microhand_planner.core.parameters import check_number

STOP, GO_ON = 'stop', 'go_on'


@dataclass(frozen=True)
class RecordingConfig:
    """The record of a run.

    Parameters
    ----------
    required : bool
        False: runs are executed without a record.
    on_failure : {'stop', 'go_on'}
        When there is no recorder, or it cannot write (disk full, folder not writable, a message
        larger than allowed): the run does not begin, or is brought to rest; or it goes on, and
        its result and an event say what is wrong.
    max_message_mb : float
        Larger messages are left out [MB].
    """

    required: bool = True
    on_failure: str = STOP
    max_message_mb: float = 100.0

    def __post_init__(self) -> None:
        """Check the values."""
        if not isinstance(self.required, bool):
            raise InvalidParameter('required', repr(self.required), 'true or false')
        if self.on_failure not in (STOP, GO_ON):
            raise InvalidParameter('on_failure', repr(self.on_failure), f'{STOP} or {GO_ON}')
        check_number('max_message_mb', self.max_message_mb, low=0.001, high=2000.0)

    @property
    def goes_on(self) -> bool:
        """Whether a run goes on without its record."""
        return self.on_failure == GO_ON
