"""The numbers that a fit of a logged flight estimates: those with laws that show in its output."""

import math
from collections.abc import Sequence

import numpy as np

from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.flight_logs.fit.filtered_outputs import has_sensor_lag
from dssc_jax.flight_logs.fit.least_squares import FitProblem
from dssc_jax.flight_logs.fit.minima import Minimum
from dssc_jax.flight_logs.fit.prediction import RANDOM
from dssc_jax.study import Study

PLANT_SLOTS = ("plant", "unmodelled", "actuator", "disturbance", "wind")
"""Parts of a study whose numbers show in the output for given commands, beside the lag of a sensor."""


def numbers_to_fit(study: Study, requested: Sequence[str]) -> list[str]:
    """The names of the numbers to estimate: the requested ones, or all with laws that show in the output.

    Args:
        study: The study.
        requested: Names of the requested numbers; empty: no request.

    Raises:
        ConfigError: A requested number has no law, or a law without derivatives; or no law shows in the output.
    """
    for name in requested:
        if name not in study.laws:
            raise ConfigError("names", f"'{name}' has no law in this study; {nearest(name, list(study.laws))}")
        if not study.laws[name].movable:
            raise ConfigError("names", f"'{name}' has a law of single cases, which has no derivative")
    if requested:
        return list(requested)
    names = []
    for name, law in study.laws.items():
        paths = [follower.split(".") for follower in study.followers(name)]
        if law.movable and any(shows(study, fields) for fields in paths):
            names.append(name)
    if not names:
        raise ConfigError(study.source, f"has no law of {', '.join(PLANT_SLOTS)}: give a number a law to be fitted")
    return names


def shows(study: Study, fields: Sequence[str]) -> bool:
    """Whether a number shows in the output for given commands.

    Args:
        study: The study.
        fields: The parts of its dotted name.
    """
    is_sensor_lag = fields[0] == "sensor" and fields[-1] == "mu" and has_sensor_lag(study)
    return is_sensor_lag or (fields[0] in PLANT_SLOTS and fields[-1] not in RANDOM)


def require_stated_times(study: Study, fitted_names: Sequence[str]) -> None:
    """Require that the times at which something happens to the plant are known, unless they are fitted.

    Times of the reference do not matter, because the plant gets the logged commands.

    Raises:
        ConfigError: Such a time has a law and is not fitted; the law's median is hardly the time of this flight.
    """
    for name, number in study.numbers.items():
        is_time = number.quantity.begins or number.quantity.ends
        if is_time and name in study.laws and name not in fitted_names and not name.startswith("reference."):
            raise ConfigError(
                name, f"has the law {study.laws[name]}, and a fit does not estimate it: set it to this flight's time"
            )


def insensitive_numbers(problem: FitProblem, minimum: Minimum) -> dict[str, float]:
    """Numbers on which the output hardly depends at a minimum, with their widths.

    A width is the standard deviation that the flight would leave if all other numbers were known, over that of the
    number's law. Only numbers with a width of at least 1 are returned.
    """
    widths = {}
    information = np.diag(minimum.equations.information) - problem.prior
    for name, entry in zip(problem.names, information, strict=True):
        width = 1.0 / math.sqrt(entry) if entry > 0.0 else math.inf
        if not width < 1.0:
            widths[name] = width
    return widths
