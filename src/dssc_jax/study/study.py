"""A study: a validated question, and the closed loop that answers it for one draw."""

import copy
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from dssc_jax.errors import ConfigError
from dssc_jax.loop import Loop, LoopParams
from dssc_jax.metrics import Measure
from dssc_jax.requirements import Requirement
from dssc_jax.study.build import build
from dssc_jax.study.correlation import matrix, paired, require_correlation
from dssc_jax.study.laws import Law
from dssc_jax.study.schema import StudyTable
from dssc_jax.study.tables import read_toml, require_shallow, set_dotted
from dssc_jax.types import Quantity, Scalar


def hash_of(table: Mapping[str, Any]) -> str:
    """Hash of a study's table."""
    return hashlib.sha256(json.dumps(table, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class Study:
    """A validated study.

    Args:
        table: The study file's content, overrides included; what the manifest keeps.
        source: Where it came from, for messages.
        config: The fixed tables.
        loop: The models in their slots, and the clock.
        template: Parameters of the loop; leaves are numbers, and laws where a number is uncertain.
        quantities: Meaning of each number, by dotted name.
        short: Shorter names of numbers, see :class:`Component`.
        measures: What is measured.
        requirements: What is required.
    """

    table: dict[str, Any]
    source: str
    config: StudyTable
    loop: Loop
    template: LoopParams
    quantities: dict[str, Quantity]
    short: dict[str, str]
    measures: tuple[Measure, ...]
    requirements: tuple[Requirement, ...]

    @classmethod
    def load(cls, path: str | Path) -> "Study":
        """Read and validate a study file.

        Args:
            path: A TOML file.

        Raises:
            ConfigError: file, dotted path, rule and value of the first thing that is wrong.
        """
        return cls.from_table(read_toml(path), str(path))

    @classmethod
    def from_table(cls, table: Mapping[str, Any], source: str = "study") -> "Study":
        """A study from the content of a study file.

        Raises:
            ConfigError: as :meth:`load`.
        """
        try:
            require_shallow(table)
            content = copy.deepcopy(dict(table))
            study = cls(content, source, *build(content))
            uncertain = [name for name, leaf in study.leaves().items() if isinstance(leaf, Law)]
            require_correlation(study.config.correlation, uncertain, study.axes)
            return study
        except ConfigError as error:
            raise error.within(source) from None

    def override(self, changes: Mapping[str, Any]) -> "Study":
        """The study with other values, by dotted name: ``{"controller.functions.tau_av": 0.05}``.

        Raises:
            ConfigError: a name leads nowhere, or the changed study is not valid.
        """
        table = copy.deepcopy(self.table)
        for name, value in changes.items():
            try:
                set_dotted(table, name, value)
            except ConfigError as error:
                raise error.within(self.source) from None
        return Study.from_table(table, self.source)

    def without_sweep(self) -> "Study":
        """The study at its own values."""
        return self.override({"sweep": {}}) if self.config.sweep else self

    @property
    def name(self) -> str:
        """The study's name."""
        return self.config.name

    @property
    def axes(self) -> dict[str, tuple[float, ...]]:
        """Values of each swept parameter."""
        return dict(self.config.sweep)

    @property
    def laws(self) -> dict[str, Law]:
        """The law of each uncertain number that is not swept; a swept value replaces the law."""
        return {name: leaf for name, leaf in self.leaves().items() if isinstance(leaf, Law) and name not in self.axes}

    @property
    def correlated(self) -> tuple[str, ...]:
        """The uncertain numbers that are not independent of all others."""
        return paired(self.config.correlation)

    @property
    def correlation(self) -> np.ndarray:
        """Correlation matrix of the normal variables behind :attr:`correlated`."""
        return matrix(self.config.correlation, self.correlated)

    @property
    def hash(self) -> str:
        """Hash of everything that decides the result."""
        return hash_of(self.table)

    def leaves(self) -> dict[str, float | Law]:
        """Every number of the loop by dotted name."""
        flat, _ = jax.tree_util.tree_flatten_with_path(self.template, is_leaf=lambda x: isinstance(x, Law))
        return {self._name(path): leaf for path, leaf in flat}

    def params(self, values: Mapping[str, Scalar]) -> LoopParams:
        """The loop's parameters with ``values`` (traced or not) in place of laws and swept numbers."""
        flat, tree = jax.tree_util.tree_flatten_with_path(self.template, is_leaf=lambda x: isinstance(x, Law))
        return tree.unflatten([values.get(self._name(path), leaf) for path, leaf in flat])

    def _name(self, path: tuple[Any, ...]) -> str:
        dotted = ".".join(str(getattr(key, "name", getattr(key, "idx", key))) for key in path)
        return self.short.get(dotted, dotted)
