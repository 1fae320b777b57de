# SPDX-License-Identifier: Apache-2.0
"""Columns of equal length under names that carry their units."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_AXES = 'xyz'


@dataclass(frozen=True)
class Table:
    """A tidy table: one row per time, one column per quantity.

    Parameters
    ----------
    columns : mapping of str to (n,) array
        Names end in their unit, as in ``grip_uN``; frozen here.

    Examples
    --------
    >>> table = Table({'time_s': np.array([0.0, 0.1]), 'grip_uN': np.array([5.0, 4.9])})
    >>> table['grip_uN'].max()
    np.float64(5.0)
    >>> table.array.dtype.names
    ('time_s', 'grip_uN')
    """

    columns: Mapping[str, NDArray[Any]]

    def __post_init__(self) -> None:
        """Check that the columns are equally long, and freeze them."""
        lengths = {len(column) for column in self.columns.values()}
        if len(lengths) > 1:
            raise ValueError(f'columns of lengths {sorted(lengths)}; allowed: of one length')
        for column in self.columns.values():
            column.setflags(write=False)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(next(iter(self.columns.values()), ()))

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return a column."""
        return self.columns[name]

    @property
    def array(self) -> NDArray[Any]:
        """The table as a structured array of numpy."""
        names = list(self.columns)
        kinds = [(name, self.columns[name].dtype) for name in names]
        made = np.zeros(len(self), dtype=kinds)
        for name in names:
            made[name] = self.columns[name]
        return made

    def to_pandas(self) -> Any:
        """Return a pandas DataFrame; pandas is yours to install, microhand does not need it.

        Raises
        ------
        ImportError
            pandas is not installed.
        """
        return importlib.import_module('pandas').DataFrame(dict(self.columns))


def spread(name: str, unit: str, vectors: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Return the columns of (n, 3) vectors.

    Examples
    --------
    >>> list(spread('tip', 'um', np.zeros((4, 3))))
    ['tip_x_um', 'tip_y_um', 'tip_z_um']
    """
    return {
        f'{name}_{axis}_{unit}': np.ascontiguousarray(vectors[:, k])
        for k, axis in enumerate(_AXES)
    }
