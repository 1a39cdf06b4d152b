"""The one shape of all analyses: a study, a dataset, a summary, a figure, and a folder that holds them."""

import json
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Self

import xarray as xr
from matplotlib.figure import Figure

from dssc_jax.core.errors import ConfigError
from dssc_jax.results.analysis_folder import Stored, read_analysis, save
from dssc_jax.results.summary import jsonable
from dssc_jax.study import Study


@dataclass(eq=False)
class Analysis(ABC):
    """What an analysis of a study found.

    Args:
        study: What was analysed.
        dataset: Its numbers; variables and coordinates tell their units and meanings.
        path: Its folder, once there is one.
    """

    kind: ClassVar[str]
    """Name of the analysis: of its command, and of the file that tells what a folder holds."""
    title: ClassVar[str]
    """What it is called in a report."""
    table: ClassVar[tuple[str, ...]]
    """The dataset's dimensions over which it is one table, a row each."""

    study: Study
    dataset: xr.Dataset = field(repr=False)
    path: Path | None = field(default=None, init=False, repr=False)

    @property
    @abstractmethod
    def headline(self) -> str:
        """The answer in a line."""

    @abstractmethod
    def figure(self) -> Figure:
        """The answer as a figure."""

    @abstractmethod
    def content(self) -> dict[str, Any]:
        """What :meth:`summary` tells, with arrays, infinities and NaN still in it."""

    @abstractmethod
    def settings(self) -> dict[str, Any]:
        """What the dataset does not tell and :meth:`restored` needs, for JSON."""

    @classmethod
    @abstractmethod
    def restored(cls, stored: Stored) -> Self:
        """The analysis that was saved.

        Raises:
            KeyError, TypeError, ValueError: something is missing, or is not what it should be.
        """

    def summary(self) -> dict[str, Any]:
        """The analysis in plain numbers, for JSON; what is infinite or not a number is None."""
        return jsonable({"study": self.study.name, **self.content()})

    def save(self, folder: str | Path) -> Path:
        """Write description, dataset and summary into a folder.

        Args:
            folder: Made when absent; one that holds this analysis of the same study is written anew.

        Raises:
            ConfigError: the folder holds something else.
        """
        self.path = save(Path(folder), self.kind, self.study, self.dataset, self.summary(), self.settings())
        return self.path

    @classmethod
    def load(cls, folder: str | Path, trust_code: bool = False) -> Self:
        """Read what :meth:`save`, or the command, wrote.

        Args:
            folder: The folder.
            trust_code: Import the models that its study names as ``module:object``.

        Raises:
            ConfigError: it holds no such analysis, or it is damaged.
        """
        stored = read_analysis(Path(folder), cls.kind, trust_code)
        try:
            analysis = cls.restored(stored)
        except ConfigError:
            raise
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
            rule = f"{cls.kind}.json is damaged, or of another version: {error!r}"
            raise ConfigError(str(folder), rule) from error
        analysis.path = Path(folder)
        return analysis

    def __eq__(self, other: object) -> bool:
        """Whether both say the same of the same study."""
        if not isinstance(other, type(self)):
            return NotImplemented
        own, others = (json.dumps(each.summary(), sort_keys=True) for each in (self, other))
        return self.study.hash == other.study.hash and own == others and self.dataset.identical(other.dataset)

    __hash__ = None  # type: ignore[assignment]
