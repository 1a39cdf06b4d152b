"""Base class of all analyses; it saves and loads an analysis by the types of its fields."""

import json
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Self, TypeVar, get_type_hints

import xarray as xr
from matplotlib.figure import Figure

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.json_types import JsonObject
from dssc_jax.results.analysis_folder import read_analysis, save
from dssc_jax.results.fields import STORED_APART, restored_fields, stored_fields
from dssc_jax.results.summary import jsonable
from dssc_jax.study import Study

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


APART = {STORED_APART: True}  # metadata of a field


@dataclass(eq=False)
class Analysis(ABC):
    """The result of an analysis of a study.

    A kind of analysis is a dataclass with further fields, which are saved by their types. Its :attr:`answer` is a
    frozen dataclass whose fields have units and meanings. JSON, report and documentation follow from these fields.

    Args:
        study: The study that was analysed.
        dataset: The numbers of the analysis; variables and coordinates have units and meanings as attributes.
        path: Folder of the analysis, if it has been saved.
        integration: The error of integration between the samples
            (:meth:`dssc_jax.engine.integration.IntegrationError.to_dict`), if it was checked.
    """

    kind: ClassVar[str]
    """Name of the analysis, its command, and the file that identifies a folder's content."""
    title: ClassVar[str]
    """Title of the analysis in a report."""
    table: ClassVar[tuple[str, ...]]
    """Dimensions of the dataset for which the exported table has rows, one for each combination of indices."""

    study: Study = field(metadata=APART)
    dataset: xr.Dataset = field(repr=False, metadata=APART)
    path: Path | None = field(default=None, init=False, repr=False, metadata=APART)
    integration: JsonObject | None = field(default=None, init=False, repr=False, metadata=APART)

    @property
    @abstractmethod
    def headline(self) -> str:
        """The answer in one line."""

    @abstractmethod
    def figure(self) -> Figure:
        """Plot the answer."""

    @property
    @abstractmethod
    def answer(self) -> "DataclassInstance":
        """The answer: a frozen dataclass whose fields have units and meanings, ``Annotated[..., Quantity(...)]``."""

    @classmethod
    def answer_type(cls) -> type:
        """The type of :attr:`answer`, as its annotation declares it."""
        getter = cls.answer.fget
        assert getter is not None
        return get_type_hints(getter)["return"]

    def summary(self) -> JsonObject:
        """The answer in plain numbers, for JSON, with the name of the study; infinite values and NaN become None."""
        integration = {} if self.integration is None else {"integration": self.integration}
        return {"study": self.study.name} | jsonable(self.answer) | integration

    def save(self, folder: str | Path) -> Path:
        """Write description, dataset and summary into a folder.

        Args:
            folder: Created if absent; overwritten if it contains this analysis of the same study.

        Raises:
            ConfigError: The folder contains something else.
        """
        content = stored_fields(self) | {"integration": self.integration}
        self.path = save(Path(folder), self.kind, self.study, self.dataset, self.summary(), content)
        return self.path

    @classmethod
    def load(cls, folder: str | Path, trust_code: bool = False) -> Self:
        """Load an analysis written by :meth:`save` or by the command.

        Args:
            folder: The folder.
            trust_code: Whether to import the models that the study names as ``module:object``.

        Raises:
            ConfigError: The folder contains no such analysis, or the analysis is damaged.
        """
        stored = read_analysis(Path(folder), cls.kind, trust_code)
        integration = stored.settings.pop("integration", None)
        try:
            analysis = restored_analysis(cls, stored.study, stored.dataset, stored.settings)
            _ = analysis.answer  # damage raises here, not where the answer is used
        except ConfigError as error:
            rule = f"{cls.kind}.json is damaged, or of another version: {error}"
            raise ConfigError(str(folder), rule) from error
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
            rule = f"{cls.kind}.json is damaged, or of another version: {error!r}"
            raise ConfigError(str(folder), rule) from error
        analysis.path = Path(folder)
        analysis.integration = integration
        return analysis

    def __eq__(self, other: object) -> bool:
        """Whether another object is an analysis of the same kind and study, with the same numbers."""
        if not isinstance(other, type(self)):
            return NotImplemented
        if self.study.hash != other.study.hash or not self.dataset.identical(other.dataset):
            return False
        return json.dumps(self.summary(), sort_keys=True) == json.dumps(other.summary(), sort_keys=True)

    __hash__ = None  # type: ignore[assignment]  # an analysis is mutable


Kind = TypeVar("Kind", bound=Analysis)


def restored_analysis(kind: type[Kind], study: Study, dataset: xr.Dataset, settings: JsonObject) -> Kind:
    """Rebuild an analysis from its study, its dataset and its stored fields.

    Args:
        kind: Class of the analysis.
        study: The study.
        dataset: The dataset.
        settings: All other fields, as :func:`dssc_jax.results.fields.stored_fields` returned them.

    Raises:
        ConfigError: A field is missing or has a value of another type; the message names it.
    """
    return kind(study, dataset, **restored_fields(kind, settings))
