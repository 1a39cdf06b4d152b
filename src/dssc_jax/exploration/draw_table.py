"""The draws of a result as a table: one row for each draw at each point of the sweep."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dssc_jax.plotting.style import drawable
from dssc_jax.results.result import Result, headline_measure
from dssc_jax.results.schema import name_with_unit

MOST_ROWS = 100_000
"""Largest number of draws on a page."""


@dataclass(frozen=True)
class DrawTable:
    """The draws of a result at all points of the sweep, one row for each draw and point.

    Args:
        result: The result.
        max_rows: Largest number of rows; of a larger result, only every k-th draw is taken.
    """

    result: Result
    max_rows: int = MOST_ROWS

    @property
    def total(self) -> int:
        """Number of lanes of the result: draws times points of the sweep."""
        return self.result.failed.size

    @cached_property
    def rows(self) -> np.ndarray:
        """Flat index of each row in the grid of points and draws, shape (rows,)."""
        step = max(1, math.ceil(self.total / self.max_rows))
        return np.arange(0, self.total, step)

    @property
    def complete(self) -> bool:
        """Whether the table has all lanes of the result."""
        return len(self.rows) == self.total

    @cached_property
    def columns(self) -> dict[str, np.ndarray]:
        """Swept numbers, drawn numbers and metrics by name, shape (rows,); NaN if a number is not finite."""
        study = self.result.study
        dataset = self.result.dataset
        grid = dataset["outcome"]
        columns = {}
        for name in (*study.axes, *study.laws, *(measure.name for measure in study.measures)):
            values = dataset[name].broadcast_like(grid).transpose(*grid.dims).values
            columns[name] = drawable(values.reshape(-1)[self.rows])
        return columns

    @cached_property
    def failed(self) -> np.ndarray:
        """Whether the draw of each row failed, shape (rows,)."""
        return self.result.failed.values.reshape(-1)[self.rows]

    @cached_property
    def draw(self) -> np.ndarray:
        """Index of the draw of each row, shape (rows,)."""
        return self.rows % self.result.study.config.draws

    def label(self, name: str) -> str:
        """The name of a column with its unit."""
        return name_with_unit(name, self.result.dataset[name].attrs.get("units", ""))

    @property
    def first_axes(self) -> tuple[str, str]:
        """Columns that the axes x and y show at first: a swept or drawn number, and the headline metric.

        If the study has no swept or drawn number, both axes show the metric.
        """
        numbers = [*self.result.study.axes, *self.result.study.laws]
        metric = headline_measure(self.result.study).name
        return (numbers[0] if numbers else metric), metric

    def point(self, row: int) -> dict[str, float]:
        """Values of the swept numbers in a row."""
        return {name: float(self.columns[name][row]) for name in self.result.study.axes}

    def replay_commands(self, folder: str) -> tuple[str, list[str]]:
        """Return the command line that replays a draw, up to the draw's index, and the names of the swept numbers.

        The values of these numbers follow the index, each as ``--at NAME=VALUE``.

        Args:
            folder: The results folder, quoted for a shell.
        """
        return f"dssc-jax replay {folder} --draw ", list(self.result.study.axes)
