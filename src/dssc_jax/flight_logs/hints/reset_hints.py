"""The hints of a comparison or a fit about a log's estimator: its resets, and the spans in which it was invalid."""

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.reading.reader import FlightLog
from dssc_jax.flight_logs.reading.resets import Reset, reset_list
from dssc_jax.flight_logs.signal_warnings import Hint
from dssc_jax.study import Study

TRIFLE = 1e-3  # m, m/s or rad: a smaller jump that the log states is not reported
LARGE_SPEED = 0.1  # m/s: a larger jump of a velocity moves the vehicle, as its loops follow the estimate


def study_end(study: Study, log: FlightLog) -> float:
    """The time of the log at which the study ends, or at which the log ends if that is earlier [s]."""
    return min(log.start + study.loop.sample_time * (study.loop.steps - 1), log.end)


def relevant_resets(study: Study, log: FlightLog) -> list[Reset]:
    """The resets within the study whose jump is not negligible, or is not stated by the log.

    Args:
        study: The study.
        log: The flight.
    """
    end = study_end(study, log)
    resets = [reset for reset in log.resets if log.start < reset.time <= end]
    return [reset for reset in resets if reset.size > TRIFLE or not reset.is_stated]


def reset_hints(study: Study, log: FlightLog) -> dict[str, Hint]:
    """Hints about the resets within the study, by counter, and about spans with invalid estimates, by flag."""
    resets_by_counter: dict[str, list[Reset]] = {}
    for reset in relevant_resets(study, log):
        resets_by_counter.setdefault(reset.label, []).append(reset)
    hints = {}
    for label, resets in resets_by_counter.items():
        if all(reset.is_removed for reset in resets):
            text = "the jump is taken out of the estimate and its setpoints"
        elif resets[0].is_speed:
            text = "the flight followed a wrong velocity before it, and this jump is not taken out"
        else:
            text = "the log does not state the jump, which stays in the signals. Take a part before or after it"
        hints[label] = Hint("estimator-reset", f"tells a reset of the estimator {reset_list(resets)}: {text}")
    end = study_end(study, log)
    for span in log.invalid:
        if span.begin <= end and span.end > log.start:
            label, _, description = span.text().partition(" ")
            fields = ", ".join(span.fields)
            text = f"{description}: the estimator calls {fields} invalid there, and they are left out"
            hints[label] = Hint("invalid-values", text)
    return hints


def require_no_jumps(study: Study, log: FlightLog) -> None:
    """Require that no jump of the estimator is left in the signals of a fit.

    Raises:
        ConfigError: A jump is left. The message has the parts of the log that can be fitted.
    """
    remaining_resets = []
    for reset in relevant_resets(study, log):
        if not reset.is_removed and not (reset.is_stated and reset.size < LARGE_SPEED):
            remaining_resets.append(reset)
    if not remaining_resets:
        return
    sample_time = study.loop.sample_time
    bounds = [log.start, *(reset.time for reset in remaining_resets), study_end(study, log)]
    parts = []
    if bounds[1] - log.start > sample_time:
        duration = sample_time * np.floor((bounds[1] - log.start) / sample_time)
        parts.append(f"the part before with loop.duration = {duration:g}")
    longest = 1 + int(np.argmax(np.diff(bounds[1:])))
    length = bounds[longest + 1] - bounds[longest]
    if length > sample_time:
        until = "" if longest == len(remaining_resets) else f" and loop.duration = {length:.4g}"
        parts.append(f"a part after with a start of {bounds[longest]:.4g} s{until}")
    names = ", ".join(dict.fromkeys(reset.label for reset in remaining_resets))
    raise ConfigError(
        log.name,
        f"{names}: the estimator was reset {reset_list(remaining_resets)}, and no vehicle has flown such a jump. "
        f"Fit {' or '.join(parts) or 'another log'}; `allow_damaged` fits it all the same",
    )
