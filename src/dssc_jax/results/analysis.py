"""Base class of all analyses: a study, a dataset, a summary and a figure, saved in a folder."""

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
    """The result of an analysis of a study.

    Args:
        study: The study that was analysed.
        dataset: Its numbers; variables and coordinates have units and meanings as attributes.
        path: Its folder, if it has been saved.
        integration: The error of integration between the samples
            (:meth:`dssc_jax.engine.integration.IntegrationError.to_dict`), if it was checked.
    """

    kind: ClassVar[str]
    """Name of the analysis, its command, and the file that identifies a folder's content."""
    title: ClassVar[str]
    """Title of the analysis in a report."""
    table: ClassVar[tuple[str, ...]]
    """The dataset's dimensions over which it is one table, with one row for each element."""

    study: Study
    dataset: xr.Dataset = field(repr=False)
    path: Path | None = field(default=None, init=False, repr=False)
    integration: dict[str, Any] | None = field(default=None, init=False, repr=False)

    @property
    @abstractmethod
    def headline(self) -> str:
        """The answer in one line."""

    @abstractmethod
    def figure(self) -> Figure:
        """Plot the answer."""

    @abstractmethod
    def content(self) -> dict[str, Any]:
        """The content of :meth:`summary`, still with arrays, infinities and NaN."""

    @abstractmethod
    def settings(self) -> dict[str, Any]:
        """What :meth:`restored` needs besides the dataset, for JSON."""

    @classmethod
    @abstractmethod
    def restored(cls, stored: Stored) -> Self:
        """Restore a saved analysis.

        Raises:
            KeyError, TypeError, ValueError: something is missing or has the wrong type or value.
        """

    def summary(self) -> dict[str, Any]:
        """The analysis in plain numbers, for JSON; infinite values and NaN become None."""
        checked = {} if self.integration is None else {"integration": self.integration}
        return jsonable({"study": self.study.name, **self.content(), **checked})

    def save(self, folder: str | Path) -> Path:
        """Write description, dataset and summary into a folder.

        Args:
            folder: Created if absent; overwritten if it contains this analysis of the same study.

        Raises:
            ConfigError: the folder contains something else.
        """
        settings = self.settings() | {"integration": self.integration}
        self.path = save(Path(folder), self.kind, self.study, self.dataset, self.summary(), settings)
        return self.path

    @classmethod
    def load(cls, folder: str | Path, trust_code: bool = False) -> Self:
        """Load an analysis written by :meth:`save` or by the command.

        Args:
            folder: The folder.
            trust_code: Import the models that its study names as ``module:object``.

        Raises:
            ConfigError: it contains no such analysis, or it is damaged.
        """
        stored = read_analysis(Path(folder), cls.kind, trust_code)
        integration = stored.settings.pop("integration", None)
        try:
            analysis = cls.restored(stored)
        except ConfigError:
            raise
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
            rule = f"{cls.kind}.json is damaged, or of another version: {error!r}"
            raise ConfigError(str(folder), rule) from error
        analysis.path = Path(folder)
        analysis.integration = integration
        return analysis

    def __eq__(self, other: object) -> bool:
        """Whether both are equal analyses of the same study."""
        if not isinstance(other, type(self)):
            return NotImplemented
        if self.study.hash != other.study.hash or not self.dataset.identical(other.dataset):
            return False
        return json.dumps(self.summary(), sort_keys=True) == json.dumps(other.summary(), sort_keys=True)

    __hash__ = None  # type: ignore[assignment]
