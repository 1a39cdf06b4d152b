"""``Study``: a validated study file and the closed loop that it describes."""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Concatenate, ParamSpec, TypeVar

import numpy as np
from jax.tree_util import keystr, tree_flatten, tree_flatten_with_path

from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.closed_loop.metrics.requirements import Requirement
from dssc_jax.closed_loop.metrics.streaming import Measure
from dssc_jax.core.errors import ConfigError, errors_in_file
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.toml import TomlTable
from dssc_jax.core.units import ChannelUnits
from dssc_jax.study.build import build
from dssc_jax.study.correlation import correlated_names, correlation_matrix, require_correlation
from dssc_jax.study.expressions import Numeric, is_expression
from dssc_jax.study.formula_tokens import tokens_of
from dssc_jax.study.laws import Law, RangedLaw, UncertainValue
from dssc_jax.study.library import find_study
from dssc_jax.study.native import with_digests, without_old_digests
from dssc_jax.study.numbers import Number
from dssc_jax.study.overview import overview
from dssc_jax.study.parameters import TEXTS, names_within
from dssc_jax.study.recorded import with_records
from dssc_jax.study.schema import StudyTable
from dssc_jax.study.tables import PARAMETERS, read_toml, with_changes

Arguments = ParamSpec("Arguments")
Answer = TypeVar("Answer")


def with_files(table: Mapping[str, object], folder: Path) -> TomlTable:
    """Copy a study's table, with the content of its recorded signals and the digests of its native code.

    Args:
        table: Table of the study.
        folder: Folder to which the names of files are relative.

    Raises:
        ConfigError: A file cannot be read.
    """
    return with_digests(with_records(table, folder), folder)


def hash_of(table: Mapping[str, object]) -> str:
    """SHA-256 hash of a table, such as a study's; equal tables have equal hashes."""
    return hashlib.sha256(json.dumps(table, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True, repr=False)
class Study:
    """A validated study: one closed loop, the laws of its numbers, its sweep and its requirements.

    Args:
        table: Content of the study file with all overrides, as stored in the manifest.
        source: Origin of the study, such as its file, for messages.
        config: Fixed tables of the study.
        loop: Models in their slots, and the clock.
        template: Parameters of the loop; the leaves are numbers, laws, and expressions of parameters with laws.
        units: Units and meanings of each channel's output and command, in the order of the channels.
        numbers: Record of each number of the loop by dotted name: meaning, value or law, and paths in the template.
        measures: Metrics to compute.
        requirements: Requirements that a draw must meet.
    """

    table: TomlTable
    source: str
    config: StudyTable
    loop: Loop
    template: LoopParams
    units: tuple[ChannelUnits, ...]
    numbers: dict[str, Number]
    measures: tuple[Measure, ...]
    requirements: tuple[Requirement, ...]

    def __repr__(self) -> str:
        """One line with the study's name, its draws, and the counts of uncertain and swept numbers."""
        uncertain = len(self.written_laws)
        return f"<Study {self.name!r}: {self.config.draws} draws, {uncertain} uncertain, {len(self.axes)} swept>"

    def __str__(self) -> str:
        """The study on one page of text."""
        return overview(self)

    @classmethod
    def load(cls, path: str | Path) -> "Study":
        """Read and validate a study; models that the study names as ``module:object`` are imported.

        Recorded signals (``file`` and ``column``) are read from files relative to the study's folder. Native code must
        have been loaded before (:func:`dssc_jax.allow_native`).

        Args:
            path: TOML file, or the name of a packaged study, as on the command line.

        Raises:
            ConfigError: The study is not valid; the message has file, dotted path, rule and value of the first error.
        """
        file = find_study(str(path))
        return cls.from_table(with_files(read_toml(file), file.parent), str(path))

    @classmethod
    def from_table(cls, table: Mapping[str, object], source: str = "study") -> "Study":
        """Build a study from the content of a study file; models that the content names are imported.

        Args:
            table: Content of a study file.
            source: Origin of the table, for messages.

        Raises:
            ConfigError: As in :meth:`load`.
        """
        content = with_changes(table, {}, source)  # a copy
        with errors_in_file(source):
            study = cls(table=content, source=source, **build(content)._asdict())
            names_of_laws = [name for name, number in study.numbers.items() if isinstance(number.value, Law)]
            require_correlation(study.config.correlation, names_of_laws, study.axes)
            for name in study.correlated:
                if name in study.ranged_laws:
                    rule = f"the arguments of the law of {name} are ranges; such a number cannot be correlated"
                    raise ConfigError("correlation", rule)
            return study

    def override(self, changes: Mapping[str, object]) -> "Study":
        """Return the study with other values by dotted name, such as ``{"controller.functions.tau_av": 0.05}``.

        A changed file of native code also gets the digest of its present content.

        Raises:
            ConfigError: A name does not exist, or the changed study is not valid.
        """
        table = with_changes(self.table, without_old_digests(changes), self.source)
        folder = Path(self.source).parent
        return Study.from_table(with_files(table, folder), self.source)

    def without_sweep(self) -> "Study":
        """Return the study at a single point: each swept number has its own value or law instead of its axis."""
        return self.override({"sweep": {}}) if self.config.sweep else self

    @property
    def name(self) -> str:
        """The study's name."""
        return self.config.name

    @property
    def axes(self) -> dict[str, tuple[float, ...]]:
        """Values of each swept number by dotted name, in the order of the sweep."""
        return dict(self.config.sweep)

    @property
    def written_laws(self) -> dict[str, Law]:
        """Law of each uncertain number by dotted name, as the study states it; swept numbers have no law.

        The arguments of these laws may be ranges. :attr:`laws` has the same laws, but raises an error for ranges.
        """
        return {name: leaf for name, leaf in self.leaves().items() if isinstance(leaf, Law) and name not in self.axes}

    @property
    def ranged_laws(self) -> dict[str, RangedLaw]:
        """Each law whose arguments are ranges, by dotted name of its number."""
        return {name: law for name, law in self.written_laws.items() if isinstance(law, RangedLaw)}

    @property
    def laws(self) -> dict[str, Law]:
        """Law of each uncertain number by dotted name, for making draws; swept numbers have no law.

        Raises:
            ConfigError: The arguments of a law are ranges.
        """
        self.require_single_laws()
        return self.written_laws

    def require_single_laws(self) -> None:
        """Require that no law has ranges as arguments, so that draws can be made from every law.

        Raises:
            ConfigError: The arguments of a law are ranges.
        """
        for name, law in self.ranged_laws.items():
            rule = (
                f"{name}: the arguments of {law} are ranges, so there is no single law to draw from; `laws` gives the "
                f"failure probability over all of them (in Python: dj.law_ranges); elsewhere give numbers, such as "
                f"{law.middle}"
            )
            raise ConfigError(self.source, rule)

    def with_laws(self, laws: Mapping[str, Law]) -> "Study":
        """Return the study with other laws of numbers, by dotted name.

        Raises:
            ConfigError: The changed study is not valid.
        """
        return self.override({name: law.table for name, law in laws.items()})

    @property
    def correlated(self) -> tuple[str, ...]:
        """Dotted names of the uncertain numbers that are correlated with others."""
        return correlated_names(self.config.correlation)

    @property
    def correlation(self) -> np.ndarray:
        """Correlation matrix of the copula's normal variables, for the numbers :attr:`correlated`, shape (n, n)."""
        return correlation_matrix(self.config.correlation, self.correlated)

    @property
    def hash(self) -> str:
        """Hash of the study's table, which determines all results."""
        return hash_of(self.table)

    @property
    def quantities(self) -> dict[str, Quantity]:
        """Unit, meaning and admissible interval of each number by dotted name."""
        return {name: number.quantity for name, number in self.numbers.items()}

    @property
    def uncertain(self) -> tuple[str, ...]:
        """Dotted names of the numbers that differ between draws: each has a law, or follows from a parameter's law."""
        laws = self.written_laws.keys()
        return tuple(name for name, number in self.numbers.items() if laws & {name, *number.sources})

    def followers(self, name: str) -> tuple[str, ...]:
        """Dotted names of the loop's numbers that change if a number changes.

        For a parameter, these are all numbers that follow from it; for any other number, the number itself.
        """
        parameter_names = self.parameter_names
        if name not in parameter_names:
            return (name,)
        follower_names = [number.name for number in self.numbers.values() if name in number.sources]
        return tuple(follower for follower in follower_names if follower not in parameter_names)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Dotted names of the study's parameters."""
        return tuple(f"{PARAMETERS}.{name}" for name in self.config.parameters)

    def unused_parameters(self) -> tuple[str, ...]:
        """Dotted names of the parameters that no expression and no formula of the study names."""
        content = [value for name, value in self.table.items() if name not in TEXTS]
        used_names = set(names_within(content))
        for table in self.config.requirement:
            if table.formula is not None:
                used_names.update(token.text for token in tokens_of(table.formula))
        return tuple(f"{PARAMETERS}.{name}" for name in self.config.parameters if name not in used_names)

    def require_free(self, name: str) -> None:
        """Require that a number can be changed, because no expression determines it.

        Raises:
            ConfigError: An expression determines the number.
        """
        number = self.numbers.get(name)
        if number and number.expression:
            raise ConfigError(name, number.follows)
        section, _, field = name.partition(".")  # such as loop.sample_time, which is no number of the loop
        table = self.table.get(section)
        entry = table.get(field) if isinstance(table, Mapping) else None
        if is_expression(entry):
            raise ConfigError(name, f"is the expression {entry!r} in this study; give it a number of its own first")

    def derived(self, values: Mapping[str, Numeric]) -> dict[str, Numeric]:
        """Values of the numbers that follow from parameters, by dotted name.

        Args:
            values: Numbers, arrays or traced values of parameters, by dotted name.

        Returns:
            One value, or array, for each number whose expression depends on one of these parameters. A number that
            also depends on the law of a parameter that is not among ``values`` is left out.
        """
        values_by_name = {}
        for name, number in self.numbers.items():
            expression = number.expression
            if expression is None:
                continue
            names_a_value = not values.keys().isdisjoint(expression.names)
            has_all_laws = values.keys() >= expression.laws.keys()
            if names_a_value and has_all_laws:
                values_by_name[name] = expression.at(values)
        return values_by_name

    def violations(self, values: Mapping[str, Numeric]) -> dict[str, str]:
        """The rule that a number would violate at given values, in words, by dotted name of each such number.

        The result is empty if all values are admissible.

        Args:
            values: Values, or arrays of values, by dotted name. Numbers that follow from these values are checked, too.
        """
        rules_by_name = {}
        for name, column in (dict(values) | self.derived(values)).items():
            low = float(np.min(column))
            high = float(np.max(column))
            quantity = self.numbers[name].quantity
            rule = quantity.violated_by(low, high)
            if rule is None and quantity.whole and np.any(np.mod(column, 1.0)):
                rule = "must be a whole number"
            if rule is None and not np.all(np.isfinite(column)):
                rule = "must be finite"
            if rule:
                rules_by_name[name] = f"{rule}, got [{low:.4g}, {high:.4g}]"
        return rules_by_name

    def leaves(self) -> dict[str, float | UncertainValue]:
        """Value, law or expression of each number by dotted name."""
        return {name: number.value for name, number in self.numbers.items()}

    def params(self, values: Mapping[str, Numeric]) -> LoopParams:
        """The parameters of the loop in one draw, or in one trace, with values in place of laws and swept numbers.

        Args:
            values: Numbers or traced values by dotted name. Numbers that follow from these values are computed. The
                name of a leaf that is no number of the study, such as one that ``prepare`` computes, is its dotted
                path.
        """
        all_values = self.derived(values) | dict(values)
        leaves, tree = tree_flatten(self.template)
        return tree.unflatten(all_values.get(name, leaf) for name, leaf in zip(self.leaf_names(), leaves, strict=True))

    def leaf_names(self) -> list[str]:
        """Name of the number at each leaf of the template; for a leaf that is no number, its dotted path."""
        name_by_path = {}
        for name, number in self.numbers.items():
            for path in number.paths:
                name_by_path[path] = name
        leaves_with_paths, _ = tree_flatten_with_path(self.template)
        paths = [keystr(path, simple=True, separator=".") for path, _ in leaves_with_paths]
        return [name_by_path.get(path, path) for path in paths]


def takes_file(
    function: Callable[Concatenate[Study, Arguments], Answer],
) -> Callable[Concatenate[Study | str | Path, Arguments], Answer]:
    """Decorate a function of a study, so that it also takes the study's file, or the name of a packaged study."""

    @wraps(function)
    def with_loaded_study(study: Study | str | Path, *arguments: Arguments.args, **options: Arguments.kwargs) -> Answer:
        """Load the study if it is a name or a path, and call the function."""
        loaded_study = study if isinstance(study, Study) else Study.load(study)
        return function(loaded_study, *arguments, **options)

    return with_loaded_study
