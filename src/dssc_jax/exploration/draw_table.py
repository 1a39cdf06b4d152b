"""The draws of a result as a table: one row for each draw at each point of the sweep."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dssc_jax.plotting.style import DRAWABLE
from dssc_jax.results.result import Result, headline

MOST_ROWS = 100_000  # that a page shows


@dataclass(frozen=True)
class DrawTable:
    """The draws of a result.

    Args:
        result: The result.
        max_rows: Largest number of rows; of a larger result, every k-th draw is taken.
    """

    result: Result
    max_rows: int = MOST_ROWS

    @property
    def total(self) -> int:
        """Number of draws, times points of the sweep."""
        return self.result.failed.size

    @cached_property
    def rows(self) -> np.ndarray:
        """Flat positions of the rows in the grid of points and draws."""
        return np.arange(0, self.total, max(1, -(-self.total // self.max_rows)))

    @property
    def complete(self) -> bool:
        """Whether the table has every draw."""
        return len(self.rows) == self.total

    @cached_property
    def columns(self) -> dict[str, np.ndarray]:
        """Swept numbers, drawn numbers and metrics by name, each of shape (rows,); NaN where there is no value."""
        study = self.result.study
        dataset = self.result.dataset
        grid = dataset["outcome"]
        columns = {}
        for name in (*study.axes, *study.laws, *(measure.name for measure in study.measures)):
            values = dataset[name].broadcast_like(grid).transpose(*grid.dims).values
            column = values.reshape(-1)[self.rows]
            columns[name] = np.where(np.abs(column) < DRAWABLE, column, np.nan)
        return columns

    @cached_property
    def failed(self) -> np.ndarray:
        """Whether each row's draw failed."""
        return self.result.failed.values.reshape(-1)[self.rows]

    @cached_property
    def draw(self) -> np.ndarray:
        """Each row's draw."""
        return self.rows % self.result.study.config.draws

    def label(self, name: str) -> str:
        """A column's name with its unit."""
        unit = self.result.dataset[name].attrs.get("units", "")
        return name if unit in ("", "1") else f"{name} [{unit}]"

    @property
    def first_axes(self) -> tuple[str, str]:
        """The columns to show first: a number and the headline metric."""
        numbers = [*self.result.study.axes, *self.result.study.laws]
        metric = headline(self.result).name
        return (numbers[0] if numbers else metric), metric

    def point(self, row: int) -> dict[str, float]:
        """Values of the swept numbers of a row."""
        return {name: float(self.columns[name][row]) for name in self.result.study.axes}

    def replay_commands(self, folder: str) -> tuple[str, list[str]]:
        """The start of the command line that replays a draw, and the names whose values it needs."""
        return f"dssc-jax replay {folder} --draw ", list(self.result.study.axes)
