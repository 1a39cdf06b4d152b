"""Run a sensitivity analysis: simulate a method's design, and compute its quantities for every output."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from dssc_jax.analyses.conditions import require_laws, require_share
from dssc_jax.analyses.sensitivity.morris import morris_design, trajectory_count
from dssc_jax.analyses.sensitivity.outputs import FAILURE, NOISE, RowDesign, output_values, row_count
from dssc_jax.analyses.sensitivity.result import Sensitivity, sensitivity_dataset
from dssc_jax.analyses.sensitivity.shapley import shapley_design
from dssc_jax.analyses.sensitivity.sobol import sobol_design, sobol_rows
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.batching import BLOCK, Engine, evaluate, is_noisy
from dssc_jax.engine.sampling import Arrays, values_at_levels
from dssc_jax.statistics import CONFIDENCE
from dssc_jax.study import Study, takes_file


class SensitivityDesign(NamedTuple):
    """The functions of a method of sensitivity analysis: what it simulates, and which studies it refuses.

    Args:
        design: (study, whether in-loop noise is a factor, confidence) -> the simulations, and what follows from them.
        require: Raises ConfigError for a study that the method cannot treat, before anything is compiled. The result of
            the call is ignored, so a function that counts the rows may be used.
    """

    design: Callable[[Study, bool, float], RowDesign]
    require: Callable[[Study], object]


SENSITIVITY_METHODS = {
    "sobol": SensitivityDesign(sobol_design, sobol_rows),
    "shapley": SensitivityDesign(shapley_design, row_count),
    "morris": SensitivityDesign(morris_design, trajectory_count),
}


@takes_file
def sensitivity(
    study: Study, method: str = "sobol", confidence: float = CONFIDENCE, progress: ProgressCallback | None = None
) -> Sensitivity:
    """Tell which uncertain numbers matter for every metric and for failure, at the study's own values.

    Args:
        study: The study, or its file. Its sweep is ignored. Its number of draws, rounded down to a power of two, is
            the number of rows of each sample; for ``morris`` it is about the total number of simulations.
        method: ``sobol``: first-order and total indices of independent numbers. ``shapley``: Shapley effects, which
            share out the variance among correlated numbers too. ``morris``: screening of many numbers with few
            simulations.
        confidence: Confidence of the intervals.
        progress: Called with the simulations done and their total.

    Returns:
        For every output and factor, the quantities of the method with their intervals; for an output without
        quantities, the reason.

    Raises:
        ConfigError: The method is unknown or cannot treat correlated numbers, nothing is uncertain, or there are too
            few draws.
    """
    study = study.without_sweep()
    if method not in SENSITIVITY_METHODS:
        raise ConfigError("method", f"must be one of {', '.join(SENSITIVITY_METHODS)}, got {method!r}")
    require_laws(study)
    require_share("confidence", confidence)
    procedure = SENSITIVITY_METHODS[method]
    procedure.require(study)
    engine = Engine(study, min(BLOCK, study.config.draws))
    noisy = is_noisy(engine)
    design = procedure.design(study, noisy, confidence)
    count = len(design.samples) * design.rows
    results: list[Arrays] = []
    for sample in design.samples:
        results.append(evaluate(engine, values_at_levels(study, sample.levels), sample.indices))
        if progress:
            progress(len(results) * design.rows, count)
    answers = output_answers(design, results, [*(measure.name for measure in study.measures), FAILURE])
    factors = (*study.laws, NOISE) if noisy else tuple(study.laws)
    return Sensitivity(
        study=study,
        dataset=sensitivity_dataset(study, method, factors, answers.quantities, answers.missing),
        method=method,
        rows=design.rows,
        simulations=count,
        reasons=answers.reasons,
        confidence=confidence,
    )


class OutputAnswers(NamedTuple):
    """The quantities of every output, or the reasons why there are none; each field is by name of the output.

    Args:
        quantities: The quantities of the method, shape (factors, 3) each, with estimate, lower and upper end; None: the
            output has no quantities.
        reasons: Why an output has no quantities, only for such outputs.
        missing: Number of simulations in which the output has no value.
    """

    quantities: dict[str, tuple[np.ndarray, ...] | None]
    reasons: dict[str, str]
    missing: dict[str, int]


def output_answers(design: RowDesign, results: list[Arrays], names: list[str]) -> OutputAnswers:
    """Compute the quantities of each output, or the reason why it has none.

    Args:
        design: The simulations, and what follows from them.
        results: Results of the simulations, for each sample of the design.
        names: Names of the outputs: metrics, and ``failure``.
    """
    answers = OutputAnswers({}, {}, {})
    for name in names:
        values = np.stack([output_values(result, name) for result in results])
        missing = int(np.count_nonzero(~np.isfinite(values)))
        reason = f"has no value on {missing:,} simulations" if missing else design.refusal(values)
        if reason:
            answers.reasons[name] = reason
        answers.quantities[name] = None if reason else design.quantities(values)
        answers.missing[name] = missing
    return answers
