"""The settings in a study's ``[tune]``, checked before compilation."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from dssc_jax.analyses.tuning.search_variables import (
    PARAMETER_OF_NUMBER,
    SearchCoordinates,
    Theorem,
    split_parameters,
    unchanged,
)
from dssc_jax.closed_loop.metrics import Measure
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.design.certification import NotCovered
from dssc_jax.engine.evaluation import require_independent
from dssc_jax.models.controllers.dssc_forms import DsscGains
from dssc_jax.proofs import SWEEP_BOXES
from dssc_jax.study import Law, Study
from dssc_jax.study.schema import TuneTable

if TYPE_CHECKING:
    from dssc_jax.proofs.prove import AnyProved

DESCENTS = ("adam", "adabelief", "amsgrad", "lion", "nadam", "rmsprop", "sgd")  # names in optax
EVOLUTION = "differential_evolution"  # in scipy.optimize
PROGRAMMING = "sqp"  # SLSQP, in scipy.optimize
SIMPLEX = "nelder_mead"  # in scipy.optimize; for proved numbers only
OBJECTIVE = "objective"  # an aim
PROVED_ERROR = "proved_error"  # an aim
REACH_BOXES = 1  # boxes of uncertain numbers, at each value of a walk: a value without a proof is known early
OPTIMISERS = (*DESCENTS, PROGRAMMING, EVOLUTION)
WIDTH = "controller.sign_width"
ASSUMED = ("plant", "reference", "disturbance")  # parts of the loop whose numbers the theorem's bounds are made of
UNKNOWN_WORDS = ("unknown", "nowhere")  # in the rules of errors about names that a study does not have


def example(study: Study) -> str:
    """The smallest ``[tune]`` of a study: its controller's first positive gain, and its first metric."""
    gains = {
        name: value
        for name, value in study.leaves().items()
        if name.startswith("controller.") and isinstance(value, float) and value > 0.0 and is_free(study, name)
    }
    ranges = [f'"{name}" = [{value / 3.0:.3g}, {value * 3.0:.3g}]' for name, value in list(gains.items())[:1]]
    metric = next((measure.name for measure in study.measures), "error_rms")
    return f"[tune] parameters = {{ {', '.join(ranges)} }}, objective = {{ {metric} = 1.0 }}"


def is_free(study: Study, name: str) -> bool:
    """Whether a number may differ between draws and follows from no parameter."""
    return study.quantities[name].law and study.numbers[name].expression is None


NumbersKey: TypeAlias = tuple[tuple[str, float], ...]
"""The loop's numbers, as the key of a proof."""


class ProvedAim(NamedTuple):
    """The proved number at a point.

    Args:
        value: Bound of |e| once settled, or the last value at which the loop is proved; None if it is not proved.
        proof: The proof of that value; None if it is not proved.
        reason: Why there is no proof; empty otherwise.
    """

    value: float | None
    proof: "AnyProved | None"
    reason: str


@dataclass(frozen=True)
class Plan:
    """The settings of a tuning, read from the study's ``[tune]`` and checked.

    Args:
        study: The study without its sweep.
        table: Its ``[tune]``.
        coordinates: The tuned numbers with their bounds, mapped to unbounded search variables.
        theorem: Certifies every point; None if no certificate is required.
        seed: Seed of the training and validation draws; the final verdict uses the study's own draws.
    """

    study: Study
    table: TuneTable
    coordinates: SearchCoordinates
    theorem: Theorem | None
    seed: int
    _proofs: "dict[NumbersKey, AnyProved]" = field(default_factory=dict, repr=False, compare=False)
    _aims: dict[NumbersKey, ProvedAim] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(cls, study: Study) -> "Plan":
        """Create the plan of a study.

        Raises:
            ConfigError: dotted path, rule and value of the first error.
        """
        try:
            return cls._of(study.without_sweep())
        except ConfigError as error:
            raise error.within(study.source) from None

    @classmethod
    def _of(cls, study: Study) -> "Plan":
        table = study.config.tune
        if table is None:
            raise ConfigError("tune", f"is required and missing; for example: {example(study)}")
        if table.optimiser not in OPTIMISERS:
            rule = f"unknown name '{table.optimiser}'; {nearest(table.optimiser, OPTIMISERS)}"
            raise ConfigError("tune.optimiser", rule)
        if table.batch is not None and table.optimiser == PROGRAMMING:
            raise ConfigError("tune.batch", f"{PROGRAMMING} needs the same draws at every step; take one of {DESCENTS}")
        if table.batch is not None and table.batch > table.draws:
            raise ConfigError("tune.batch", f"must be <= draws = {table.draws}, got {table.batch}")
        require_independent(study, "a tuning's verdict")
        seed = seed_of(study, table)
        if seed == study.config.seed:
            raise ConfigError("tune.seed", f"must not be the study's own, whose draws decide, got {seed}")
        require_metrics(study, table)
        if table.smoothing is not None:
            require_sign(study)
        require_room(study, table)
        for name in table.parameters:
            require_number(study, name, table)
        theorem = None
        varied = dict(table.parameters)
        starts = {name: inside_range(study, name, table.parameters[name]) for name in table.parameters}
        if table.certified:
            free, fixed = split_parameters(table.free)
            theorem = Theorem(study, fixed)
            starts |= {name: (low * high) ** 0.5 for name, (low, high) in free.items()}
            varied |= free
            if table.slack is not None:
                rule = "belongs to certified = false; a certified design meets the inequalities by construction"
                raise ConfigError("tune.slack", rule)
        elif table.free:
            raise ConfigError("tune.free", "belongs to certified = true")
        elif table.slack is not None:
            theorem = Theorem(study, {}, "tune.slack")
        require_aim(study, table)
        if table.proved:
            require_provable(study)
        if not varied:
            raise ConfigError("tune.parameters", "names nothing to tune; give NAME = [low, high]")
        coordinates = SearchCoordinates(varied, starts, theorem.expand if theorem and table.certified else unchanged)
        return cls(study, table, coordinates, theorem, seed)

    @property
    def measures(self) -> dict[str, Measure]:
        """The measures that objective and limits need, by name."""
        by_name = {measure.name: measure for measure in self.study.measures}
        return {name: by_name[name] for name in (*self.table.objective, *self.table.limits)}

    def proof_at(self, numbers: Mapping[str, float]) -> "AnyProved":
        """The proof of the study with other numbers, as far as there is one."""
        from dssc_jax.proofs.prove import prove

        key = tuple(numbers.items())
        if key not in self._proofs:
            self._proofs[key] = prove(self.study.override(numbers), boxes=SWEEP_BOXES)
        return self._proofs[key]

    @property
    def optimises_proof(self) -> bool:
        """Whether a proved number is optimised, and not the objective on the draws."""
        return self.table.aim != OBJECTIVE

    def aim_at(self, numbers: Mapping[str, float]) -> ProvedAim:
        """The proved number that is optimised, of the study with other numbers."""
        if self.table.aim == PROVED_ERROR:
            proof = self.proof_at(numbers)
            if proof.complete:
                return ProvedAim(proof.error, proof, "")
            return ProvedAim(None, None, proof.reason)
        from dssc_jax.proofs.reach import proved_up_to

        ((name, bounds),) = self.table.over.items()
        key = tuple(numbers.items())
        if key not in self._aims:
            reach = proved_up_to(self.study.override(numbers), name, bounds, log=True, boxes=REACH_BOXES)
            self._aims[key] = ProvedAim(reach.proved, reach.last, reach.reason if reach.last is None else "")
        return self._aims[key]

    def proof_of_result(self, numbers: Mapping[str, float]) -> "AnyProved | None":
        """The proof to store: that of the proved number if it is optimised; None if no proof is required."""
        if self.optimises_proof:
            return self.aim_at(numbers).proof
        return self.proof_at(numbers) if self.table.proved else None

    def numbers_at(self, z: np.ndarray) -> dict[str, float]:
        """The loop's numbers at a point of the search."""
        return {name: float(value[0]) for name, value in self.coordinates.numbers(z[None]).items()}

    def trial(self) -> Study:
        """The study used for training: other draws, no plot, and only the metrics that the search reads.

        A metric of a requirement is computed in any case, so ``[metrics]`` need not name it.
        """
        in_study = {measure.name for measure in self.study.measures}
        of_requirements = {requirement.measure.name for requirement in self.study.requirements}
        to_name = in_study - of_requirements
        names = {self._written_name(measure) for name, measure in self.measures.items() if name in to_name}
        window = self.study.config.metrics.window.entries()
        return self.study.override(
            {
                "seed": self.seed,
                "draws": self.table.draws + self.table.validation,
                "plot": {},
                "metrics": window | {"names": sorted(names)},
            }
        )

    def smoothed(self) -> Study:
        """The study used for derivatives: with the first width of the sign, if it is to be smoothed."""
        width = self.table.smoothing
        return self.trial() if width is None else self.trial().override({WIDTH: width})

    def _written_name(self, measure: Measure) -> str:
        """A metric's name as written in the study; a user's metric has its dotted name."""
        for name in self.study.config.metrics.names or ():
            if name.rpartition(":")[2] == measure.kind:
                return name
        return measure.kind


def require_aim(study: Study, table: TuneTable) -> None:
    """Require what the optimisation of a proved number needs.

    Raises:
        ConfigError: the loop is outside of what a proof covers, or settings contradict each other.
    """
    if table.aim == OBJECTIVE:
        if table.over:
            raise ConfigError("tune.over", 'belongs to aim = "proved_up_to"')
        return
    if "optimiser" in table.model_fields_set:
        rule = f'belongs to aim = "{OBJECTIVE}"; a proved number is optimised by {SIMPLEX}, without derivatives'
        raise ConfigError("tune.optimiser", rule)
    if table.aim == PROVED_ERROR:
        if table.over:
            raise ConfigError("tune.over", 'belongs to aim = "proved_up_to"')
        require_provable(study, "tune.aim")
        return
    if len(table.over) != 1:
        raise ConfigError("tune.over", f'must be {{ NAME = [low, high] }} for aim = "{table.aim}", got {table.over}')
    ((name, bounds),) = table.over.items()
    if name in table.parameters:
        raise ConfigError(f"tune.over.{name}", "is tuned, too; take it out of [tune.parameters]")
    for value in bounds:
        require_provable(study, "tune.aim", (name, value))


def require_provable(study: Study, place: str = "tune.proved", at: tuple[str, float] | None = None) -> None:
    """Require a loop that a proof covers, and what proofs need.

    Args:
        study: The study.
        place: The setting that asks for proofs.
        at: A number and its value, if the loop with another value is to be proved.

    Raises:
        ConfigError: it is outside of what a proof covers, or a package is missing.
    """
    try:
        import dssc_jax.proofs.prove  # noqa: F401  (the verifier's package, too)
        from dssc_jax.proofs.coverage import problem_of
        from dssc_jax.proofs.reach import problem_at

        if at is None:
            problem_of(study)
        else:
            problem_at(study, *at)
    except ImportError as error:
        raise ConfigError(place, f"needs {error.name}: pip install 'dssc_jax[proofs]'") from None
    except NotCovered as error:
        raise ConfigError(place, f"a proof does not cover this loop: {error}") from None


def seed_of(study: Study, table: TuneTable) -> int:
    """The seed of the training and validation draws."""
    return (study.config.seed + 1) % 2**32 if table.seed is None else table.seed


def require_metrics(study: Study, table: TuneTable) -> None:
    """Require that every metric of objective and limits belongs to the study.

    Raises:
        ConfigError: one does not, or there is nothing to minimise.
    """
    names = [measure.name for measure in study.measures]
    for place, metrics in (("objective", table.objective), ("limits", table.limits)):
        for name in metrics:
            if name not in names:
                rule = f"is no metric of this study; {nearest(name, names)}; add others to metrics.names"
                raise ConfigError(f"tune.{place}.{name}", rule)
    if not any(weight != 0.0 for weight in table.objective.values()):
        raise ConfigError("tune.objective", f"needs a weight other than 0, got {table.objective}")


def require_room(study: Study, table: TuneTable) -> None:
    """Require that no two requirements, or a requirement and a limit, contradict each other.

    Raises:
        ConfigError: a metric must be above one number and below a smaller one.
    """
    required = [(r.measure.name, r.minimum, r.maximum) for r in study.requirements]
    limits = [("requirement", name, high) for name, _, high in required if high is not None]
    limits += [(f"tune.limits.{name}", name, bound) for name, bound in table.limits.items() if isinstance(bound, float)]
    for place, name, high in limits:
        floor = max((low for metric, low, _ in required if metric == name and low is not None), default=high)
        if floor > high:
            raise ConfigError(place, f"no value of {name} is >= {floor:g} and <= {high:g}: nothing can satisfy both")


def require_sign(study: Study) -> None:
    """Require that every channel's controller has a sign function that can be smoothed and is not smooth already.

    Raises:
        ConfigError: one has none, or one has its own width.
    """
    if any(not isinstance(gains, DsscGains) for gains in study.template.controller):
        raise ConfigError("tune.smoothing", "is the width of DSSC's and SSC's sign; this controller has none")
    if any(name.split(".")[-1] == "sign_width" for name in study.leaves()):
        raise ConfigError("tune.smoothing", "is the first of a falling width; take sign_width out of [controller]")


def require_number(study: Study, name: str, table: TuneTable) -> None:
    """Require that a dotted name is a plain number of the loop that can be tuned.

    Raises:
        ConfigError: it is something else, or is determined by other numbers.
    """
    place = f"tune.parameters.{name}"
    if table.certified and name in PARAMETER_OF_NUMBER:
        raise ConfigError(place, "is fixed by the certified design; vary [tune.free], or set certified = false")
    if name not in study.leaves():
        raise ConfigError(place, reason_unfit(study, name))
    if study.numbers[name].expression:
        raise ConfigError(place, study.numbers[name].follows)
    for follower in study.followers(name) if table.certified or table.slack is not None else ():
        part = follower.split(".")
        if part[0] in ASSUMED or "nominal" in part:
            raise ConfigError(
                place, "is what the theorem's bounds are made of, so that they would move; give it a number"
            )
        if follower != name and follower in PARAMETER_OF_NUMBER:
            raise ConfigError(place, f"decides {follower}, which the theorem takes as it is; give the gain a number")
    if not study.quantities[name].law:
        raise ConfigError(place, "is fixed before tracing (a whole number, a length), so it has no derivative")
    leaf = study.leaves()[name]
    if isinstance(leaf, Law):
        raise ConfigError(place, f"is uncertain: {leaf}; give it a number to tune it")


def reason_unfit(study: Study, name: str) -> str:
    """The reason why a name cannot be tuned, as the predicate of a sentence."""
    value: object = study.table
    for part in name.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    if value is not None:
        return f"is no number of the loop but {value!r}, which has no derivative"
    try:
        study.override({name: 1.0})
    except ConfigError as error:
        if any(word in error.rule for word in UNKNOWN_WORDS):
            return f"unknown parameter; {nearest(name, study.quantities)}"
        return f"is no number that may be moved: {error.rule}"
    return "has no value in this study; give one to start from"


def inside_range(study: Study, name: str, extent: tuple[float, float]) -> float:
    """The study's own value, which is the start of the search.

    Raises:
        ConfigError: it is outside its interval, or an end of the interval is not admissible.
    """
    low, high = extent
    value = study.leaves()[name]
    quantity = study.quantities[name]
    broken = quantity.violated_by(low, high)
    place = f"tune.parameters.{name}"
    if broken:
        raise ConfigError(place, f"{quantity.meaning} [{quantity.unit}] {broken}, got [{low:g}, {high:g}]")
    assert isinstance(value, float)
    if not low < value < high:
        raise ConfigError(place, f"the start is infeasible: the study has {value:g}, not inside ({low:g}, {high:g})")
    return value
