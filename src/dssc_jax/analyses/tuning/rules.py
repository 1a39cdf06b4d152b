"""The rules that a study's ``[tune]`` has to meet."""

from collections.abc import Mapping

from dssc_jax.analyses.tuning.search_variables import PARAMETER_OF_NUMBER
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.design.certification import NotCovered
from dssc_jax.engine.evaluation import require_independent
from dssc_jax.models.controllers.dssc_forms import DsscGains
from dssc_jax.study import Law, Study
from dssc_jax.study.schema import TuneTable

DESCENTS = ("adam", "adabelief", "amsgrad", "lion", "nadam", "rmsprop", "sgd")  # names in optax
EVOLUTION = "differential_evolution"  # in scipy.optimize
PROGRAMMING = "sqp"  # SLSQP, in scipy.optimize
SIMPLEX = "nelder_mead"  # in scipy.optimize; for proved numbers only
OBJECTIVE = "objective"  # a value of tune.aim
PROVED_ERROR = "proved_error"  # a value of tune.aim
OPTIMISERS = (*DESCENTS, PROGRAMMING, EVOLUTION)
WIDTH = "controller.sign_width"
ASSUMED = ("plant", "reference", "disturbance")  # parts of the loop on whose numbers the theorem's bounds depend
UNKNOWN_WORDS = ("unknown", "nowhere")  # words in the messages of errors about names that a study does not have


def tune_table(study: Study) -> TuneTable:
    """The table ``[tune]`` of a study, after a check of all rules for it.

    Raises:
        ConfigError: The table is missing, or breaks a rule.
    """
    table = study.config.tune
    if table is None:
        raise ConfigError("tune", f"is required and missing; for example: {example(study)}")
    require_optimiser(table)
    require_independent(study, "a tuning's verdict")
    seed = seed_of(study, table)
    if seed == study.config.seed:
        raise ConfigError("tune.seed", f"must not be the study's own, whose draws decide, got {seed}")
    require_metrics(study, table)
    if table.smoothing is not None:
        require_smoothable_sign(study)
    require_compatible_bounds(study, table)
    for name in table.parameters:
        require_tunable(study, name, table)
    require_theorem_settings(table)
    require_aim(study, table)
    if table.proved:
        require_provable(study)
    return table


def require_optimiser(table: TuneTable) -> None:
    """Require an optimiser that exists, and a batch of draws that it can take.

    Raises:
        ConfigError: There is no such optimiser, it takes no batches, or the batch is larger than the training draws.
    """
    if table.optimiser not in OPTIMISERS:
        rule = f"unknown name '{table.optimiser}'; {nearest(table.optimiser, OPTIMISERS)}"
        raise ConfigError("tune.optimiser", rule)
    if table.batch is not None and table.optimiser == PROGRAMMING:
        raise ConfigError("tune.batch", f"{PROGRAMMING} needs the same draws at every step; take one of {DESCENTS}")
    if table.batch is not None and table.batch > table.draws:
        raise ConfigError("tune.batch", f"must be <= draws = {table.draws}, got {table.batch}")


def require_theorem_settings(table: TuneTable) -> None:
    """Require settings of Theorem 1 that do not contradict each other.

    ``slack`` is allowed only without ``certified = true``, and ``free`` only with it.

    Raises:
        ConfigError: Two settings contradict each other.
    """
    if table.certified and table.slack is not None:
        rule = "belongs to certified = false; a certified design meets the inequalities by construction"
        raise ConfigError("tune.slack", rule)
    if table.free and not table.certified:
        raise ConfigError("tune.free", "belongs to certified = true")


def example(study: Study) -> str:
    """An example of a table ``[tune]`` for the error message, with the study's first positive gain and first metric."""
    range_of_gain = ""  # the controller has no positive gain
    for name, value in study.leaves().items():
        if not name.startswith("controller.") or not is_free(study, name):
            continue
        if isinstance(value, float) and value > 0.0:
            range_of_gain = f'"{name}" = [{value / 3.0:.3g}, {value * 3.0:.3g}]'
            break
    metrics = [measure.name for measure in study.measures] or ["error_rms"]
    return f"[tune] parameters = {{ {range_of_gain} }}, objective = {{ {metrics[0]} = 1.0 }}"


def is_free(study: Study, name: str) -> bool:
    """Whether a number may have a law, and is not determined by an expression."""
    return study.quantities[name].law and study.numbers[name].expression is None


def require_aim(study: Study, table: TuneTable) -> None:
    """Require settings with which ``aim`` can be optimised; a proved number also needs a loop that a proof covers.

    Raises:
        ConfigError: No proof covers the loop, or settings contradict each other.
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
    for end in bounds:
        require_provable(study, "tune.aim", at=(name, end))


def require_provable(study: Study, place: str = "tune.proved", at: tuple[str, float] | None = None) -> None:
    """Require a loop that a proof covers, and the packages that proofs need.

    Args:
        study: The study.
        place: The setting that asks for proofs, for the message.
        at: Name and value of a number to change before the loop is proved; None: the loop as the study states it.

    Raises:
        ConfigError: No proof covers the loop, or a package is missing.
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
    """The seed of the training and validation draws: that of ``[tune]``, or by default the study's own seed plus 1."""
    if table.seed is not None:
        return table.seed
    return (study.config.seed + 1) % 2**32


def require_metrics(study: Study, table: TuneTable) -> None:
    """Require an objective, and require that the study computes all metrics of objective and limits.

    Raises:
        ConfigError: The study does not compute a metric, or all weights of the objective are 0.
    """
    names = [measure.name for measure in study.measures]
    for place, metrics in (("objective", table.objective), ("limits", table.limits)):
        for name in metrics:
            if name not in names:
                rule = f"is no metric of this study; {nearest(name, names)}; add others to metrics.names"
                raise ConfigError(f"tune.{place}.{name}", rule)
    if not any(weight != 0.0 for weight in table.objective.values()):
        raise ConfigError("tune.objective", f"needs a weight other than 0, got {table.objective}")


def require_compatible_bounds(study: Study, table: TuneTable) -> None:
    """Require that some value of every metric meets all of its requirements and limits.

    Raises:
        ConfigError: A metric must be above one number and below a smaller one.
    """
    least_values: dict[str, float] = {}
    upper_bounds = []  # (place for the message, metric, largest value)
    for requirement in study.requirements:
        name = requirement.measure.name
        if requirement.minimum is not None:
            least_values[name] = max(requirement.minimum, least_values.get(name, requirement.minimum))
        if requirement.maximum is not None:
            upper_bounds.append(("requirement", name, requirement.maximum))
    for name, bound in table.limits.items():
        if isinstance(bound, float):  # the others are "start"
            upper_bounds.append((f"tune.limits.{name}", name, bound))
    for place, name, highest in upper_bounds:
        least = least_values.get(name, highest)
        if least > highest:
            raise ConfigError(place, f"no value of {name} is >= {least:g} and <= {highest:g}: nothing can satisfy both")


def require_smoothable_sign(study: Study) -> None:
    """Require controllers whose sign function ``smoothing`` can smooth, and a study that does not smooth it already.

    Raises:
        ConfigError: A controller has no such function, or the study states ``sign_width``.
    """
    if any(not isinstance(gains, DsscGains) for gains in study.template.controller):
        raise ConfigError("tune.smoothing", "is the width of DSSC's and SSC's sign; this controller has none")
    if any(name.split(".")[-1] == "sign_width" for name in study.leaves()):
        raise ConfigError("tune.smoothing", "is the first of a falling width; take sign_width out of [controller]")


def require_tunable(study: Study, name: str, table: TuneTable) -> None:
    """Require that a name of ``[tune.parameters]`` is a number of the loop that can be tuned.

    Args:
        study: The study.
        name: The dotted name.
        table: The study's ``[tune]``.

    Raises:
        ConfigError: The name is not that of a number; or the number is uncertain, follows from other numbers, is fixed
            before tracing, is fixed by a certified design, or changes the bounds of a theorem that is required.
    """
    place = f"tune.parameters.{name}"
    if table.certified and name in PARAMETER_OF_NUMBER:
        raise ConfigError(place, "is fixed by the certified design; vary [tune.free], or set certified = false")
    if name not in study.leaves():
        raise ConfigError(place, reason_unfit(study, name))
    if study.numbers[name].expression:
        raise ConfigError(place, study.numbers[name].follows)
    if table.certified or table.slack is not None:
        require_fixed_bounds(study, name)
    if not study.quantities[name].law:
        raise ConfigError(place, "is fixed before tracing (a whole number, a length), so it has no derivative")
    leaf = study.leaves()[name]
    if isinstance(leaf, Law):
        raise ConfigError(place, f"is uncertain: {leaf}; give it a number to tune it")


def require_fixed_bounds(study: Study, name: str) -> None:
    """Require that the bounds of Theorem 1 do not depend on a number that is tuned.

    Args:
        study: The study.
        name: Dotted name of the number.

    Raises:
        ConfigError: The bounds follow from the number, or another gain of Table 1 follows from it.
    """
    place = f"tune.parameters.{name}"
    for follower in study.followers(name):
        sections = follower.split(".")
        is_of_bounds = sections[0] in ASSUMED or "nominal" in sections
        if is_of_bounds:
            rule = "is what the theorem's bounds are made of, so that they would move; give it a number"
            raise ConfigError(place, rule)
        if follower != name and follower in PARAMETER_OF_NUMBER:
            raise ConfigError(place, f"decides {follower}, which the theorem takes as it is; give the gain a number")


def reason_unfit(study: Study, name: str) -> str:
    """Say why a dotted name that is no number of the loop cannot be tuned: the predicate of the error message."""
    entry: object = study.table
    for part in name.split("."):
        entry = entry.get(part) if isinstance(entry, Mapping) else None
    if entry is not None:
        return f"is no number of the loop but {entry!r}, which has no derivative"
    try:
        study.override({name: 1.0})
    except ConfigError as error:
        if any(word in error.rule for word in UNKNOWN_WORDS):
            return f"unknown parameter; {nearest(name, study.quantities)}"
        return f"is no number that may be moved: {error.rule}"
    return "has no value in this study; give one to start from"


def start_value(study: Study, name: str, extent: tuple[float, float]) -> float:
    """The value of a number in the study, at which the search starts.

    Args:
        study: The study.
        name: Dotted name of the number.
        extent: Lowest and highest value of the search.

    Raises:
        ConfigError: The value is not inside the range of the search, or an end of this range is not admissible.
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
