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
from dssc_jax.closed_loop.metrics import Measure
from dssc_jax.closed_loop.requirements import Requirement
from dssc_jax.core.errors import ConfigError
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
    """A study's table with the content of recorded signals and the digests of native code, in place of files alone.

    Raises:
        ConfigError: A file cannot be read.
    """
    return with_digests(with_records(table, folder), folder)


def hash_of(table: Mapping[str, object]) -> str:
    """Hash of a study's table."""
    return hashlib.sha256(json.dumps(table, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True, repr=False)
class Study:
    """A validated study.

    Args:
        table: The study file's content, including overrides, as stored in the manifest.
        source: Its origin, for messages.
        config: The fixed tables.
        loop: The models in their slots, and the clock.
        template: Parameters of the loop; leaves are numbers, or laws for uncertain numbers.
        units: Units and meanings of each channel's output and command, in the order of the channels.
        numbers: Every number of the loop by dotted name: meaning, value or law, and its paths in the template.
        measures: The metrics to compute.
        requirements: The requirements.
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
        uncertain = len(self.written_laws)
        return f"<Study {self.name!r}: {self.config.draws} draws, {uncertain} uncertain, {len(self.axes)} swept>"

    def __str__(self) -> str:
        return overview(self)

    @classmethod
    def load(cls, path: str | Path) -> "Study":
        """Read and validate a study; models that it refers to as ``module:object`` are imported.

        Recorded signals (``file`` and ``column``) are read from files relative to the study's folder. Native code must
        have been loaded before (:func:`dssc_jax.allow_native`).

        Args:
            path: A TOML file, or the name of a packaged study, as on the command line.

        Raises:
            ConfigError: File, dotted path, rule and value of the first error.
        """
        file = find_study(str(path))
        return cls.from_table(with_files(read_toml(file), file.parent), str(path))

    @classmethod
    def from_table(cls, table: Mapping[str, object], source: str = "study") -> "Study":
        """Build a study from the content of a study file; models it refers to as ``module:object`` are imported.

        Raises:
            ConfigError: As in :meth:`load`.
        """
        content = with_changes(table, {}, source)
        try:
            study = cls(table=content, source=source, **build(content)._asdict())
            uncertain = [name for name, number in study.numbers.items() if isinstance(number.value, Law)]
            require_correlation(study.config.correlation, uncertain, study.axes)
            for name in study.ranged_laws.keys() & set(study.correlated):
                rule = f"the arguments of the law of {name} are ranges; such a number cannot be correlated"
                raise ConfigError("correlation", rule)
            return study
        except ConfigError as error:
            raise error.within(source) from None

    def override(self, changes: Mapping[str, object]) -> "Study":
        """Return the study with other values, by dotted name: ``{"controller.functions.tau_av": 0.05}``.

        Raises:
            ConfigError: A name does not exist, or the changed study is not valid.
        """
        table = with_files(
            with_changes(self.table, without_old_digests(changes), self.source), Path(self.source).parent
        )
        return Study.from_table(table, self.source)

    def without_sweep(self) -> "Study":
        """Return the study without its sweep."""
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
    def written_laws(self) -> dict[str, Law]:
        """The law of each uncertain number that is not swept; a swept value replaces the law.

        The arguments of some may be ranges; see :attr:`laws` for what can be drawn.
        """
        return {name: leaf for name, leaf in self.leaves().items() if isinstance(leaf, Law) and name not in self.axes}

    @property
    def ranged_laws(self) -> dict[str, RangedLaw]:
        """The laws whose arguments are ranges."""
        return {name: law for name, law in self.written_laws.items() if isinstance(law, RangedLaw)}

    @property
    def laws(self) -> dict[str, Law]:
        """The law of each uncertain number that is not swept, from which draws are made.

        Raises:
            ConfigError: The arguments of one are ranges.
        """
        self.require_single_laws()
        return self.written_laws

    def require_single_laws(self) -> None:
        """Require a single law of every uncertain number, from which draws can be made.

        Raises:
            ConfigError: The arguments of one are ranges.
        """
        for name, law in self.ranged_laws.items():
            rule = (
                f"{name}: the arguments of {law} are ranges, so there is no single law to draw from; `laws` gives the "
                f"failure probability over all of them (in Python: dj.law_ranges); elsewhere give numbers, such as "
                f"{law.middle}"
            )
            raise ConfigError(self.source, rule)

    def with_laws(self, laws: Mapping[str, Law]) -> "Study":
        """Return the study with other laws of some numbers, by dotted name.

        Raises:
            ConfigError: The changed study is not valid.
        """
        return self.override({name: law.table for name, law in laws.items()})

    @property
    def correlated(self) -> tuple[str, ...]:
        """The uncertain numbers that are not independent of all others."""
        return correlated_names(self.config.correlation)

    @property
    def correlation(self) -> np.ndarray:
        """Correlation matrix of the normal variables for :attr:`correlated`."""
        return correlation_matrix(self.config.correlation, self.correlated)

    @property
    def hash(self) -> str:
        """Hash of everything that determines the result."""
        return hash_of(self.table)

    @property
    def quantities(self) -> dict[str, Quantity]:
        """Meaning of each number by dotted name."""
        return {name: number.quantity for name, number in self.numbers.items()}

    @property
    def uncertain(self) -> tuple[str, ...]:
        """Dotted names of the numbers that differ between draws: those with a law, and those that follow from one."""
        laws = self.written_laws.keys()
        return tuple(name for name, number in self.numbers.items() if laws & {name, *number.sources})

    def followers(self, name: str) -> tuple[str, ...]:
        """Dotted names of the loop's numbers that a number decides: itself, or those that follow from a parameter."""
        if name not in self.parameter_names:
            return (name,)
        follower_names = (number.name for number in self.numbers.values() if name in number.sources)
        return tuple(follower for follower in follower_names if follower not in self.parameter_names)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Dotted names of the study's parameters."""
        return tuple(f"{PARAMETERS}.{name}" for name in self.config.parameters)

    def unused_parameters(self) -> tuple[str, ...]:
        """Dotted names of the parameters that nothing in the study names."""
        content = [value for name, value in self.table.items() if name not in TEXTS]
        words = {token.text for table in self.config.requirement for token in tokens_of(table.formula or "")}
        named_parameters = {f"{PARAMETERS}.{name}" for name in {*names_within(content), *words}}
        return tuple(name for name in self.parameter_names if name not in named_parameters)

    def require_free(self, name: str) -> None:
        """Require that a number has a value of its own, and does not follow from parameters.

        Raises:
            ConfigError: It follows from them.
        """
        number = self.numbers.get(name)
        if number and number.expression:
            raise ConfigError(name, number.follows)
        slot, _, field = name.partition(".")
        table = self.table.get(slot)
        entry = table.get(field) if isinstance(table, Mapping) else None
        if is_expression(entry):
            raise ConfigError(name, f"is the expression {entry!r} in this study; give it a number of its own first")

    def derived(self, values: Mapping[str, Numeric]) -> dict[str, Numeric]:
        """The numbers that follow from parameters with the given values, by dotted name; an array for arrays.

        A number that follows from a law without a value is left out.
        """
        values_by_name = {}
        for name, number in self.numbers.items():
            expression = number.expression
            if expression and values.keys() & set(expression.names) and values.keys() >= expression.laws.keys():
                values_by_name[name] = expression.at(values)
        return values_by_name

    def violations(self, values: Mapping[str, Numeric]) -> dict[str, str]:
        """The numbers outside of their intervals at the given values, by dotted name: the rule and the values found.

        Numbers that follow from the given ones are among them.
        """
        rules_by_name = {}
        for name, column in (dict(values) | self.derived(values)).items():
            low, high = float(np.min(column)), float(np.max(column))
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
        """Value or law of each number by dotted name; of one that follows from laws, its expression."""
        return {name: number.value for name, number in self.numbers.items()}

    def params(self, values: Mapping[str, Numeric]) -> LoopParams:
        """The loop's parameters with ``values`` (traced or not) in place of laws and swept numbers.

        What follows from parameters is computed from their values. A leaf that is not a number of the study, but is
        computed from such numbers, is given by its own dotted path.
        """
        known_values = self.derived(values) | dict(values)
        leaves, tree = tree_flatten(self.template)
        return tree.unflatten(
            known_values.get(name, leaf) for name, leaf in zip(self.leaf_names(), leaves, strict=True)
        )

    def leaf_names(self) -> list[str]:
        """The name of the number at each leaf of the template; of one that is no number, its dotted path."""
        names = {path: name for name, number in self.numbers.items() for path in number.paths}
        paths = [keystr(path, simple=True, separator=".") for path, _ in tree_flatten_with_path(self.template)[0]]
        return [names.get(path, path) for path in paths]


def takes_file(
    function: Callable[Concatenate[Study, Arguments], Answer],
) -> Callable[Concatenate[Study | str | Path, Arguments], Answer]:
    """Let a function of a study also take the study's file, or the name of a packaged study."""

    @wraps(function)
    def loading(study: Study | str | Path, *arguments: Arguments.args, **options: Arguments.kwargs) -> Answer:
        return function(study if isinstance(study, Study) else Study.load(study), *arguments, **options)

    return loading
