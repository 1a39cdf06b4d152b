"""Laws of a study's numbers from a logged flight: estimates, their covariance, and what the flight cannot tell.

The residual is the logged output minus the output that the study predicts for the logged commands. It is taken for an
autoregressive process of each channel, whose order and coefficients are estimated, too. Weighted least squares then has
the covariance s^2 (J' J)^-1 of the filtered residual and its Jacobian J.

References:
    L. Ljung, System Identification: Theory for the User, 2nd ed. (1999), sections 7.4 and 9.4.
"""

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

from dssc_jax.analyses.flight_log import forward_filled, replayed_channel, signal_name
from dssc_jax.analyses.flight_residual import FitProblem, reweighted_fit, unscaled, widening
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.numerics import wrap_angle
from dssc_jax.flight.prediction import RANDOM, Prediction, prediction
from dssc_jax.flight.replay import study_references
from dssc_jax.study import Law, Study
from dssc_jax.study.flight_logs import LOGGED, FlightLog, last_time, nearest_values
from dssc_jax.study.laws import CASES, LOGARITHMIC
from dssc_jax.study.tables import enclosing_list, has_dotted, set_dotted, toml_entries

PLANT_SLOTS = ("plant", "unmodelled", "disturbance", "wind")
"""Parts of a study whose numbers show in the output for given commands."""

LEAST_SAMPLES = 20
SINGULAR_INFORMATION = 1e-10  # least eigenvalue of the scaled information matrix
INSIDE = 1e-6  # of the distance from an exclusive bound, that a law stays inside
LAW_WIDTH = 5.0  # standard deviations within which a bounded number's law is kept


class NotIdentifiable(ValueError):
    """The flight does not tell the numbers; the message says which."""


@dataclass(frozen=True)
class Fitted:
    """Numbers estimated from a flight.

    Args:
        study: The study.
        names: The estimated numbers.
        estimates: Their values, shape (n,).
        scaled: Estimates on the scale of the fit: the logarithm where the law is logarithmic.
        covariance: Covariance on that scale, shape (n, n).
        noise: Standard deviation of the residual by channel, in the unit of the output.
        orders: Order of the residual's autoregression by channel; 0: it is white.
        kept: Numbers that the flight does not tell, with the standard deviation that it leaves, in those of the law.
        samples: Samples of the log that were used.
        replayed: Channels whose commands are those of the analysed controller for the logged outputs.
    """

    study: Study
    names: tuple[str, ...]
    estimates: np.ndarray
    scaled: np.ndarray
    covariance: np.ndarray
    noise: dict[str, float]
    orders: dict[str, int]
    kept: dict[str, float]
    samples: int
    replayed: tuple[str, ...]

    @property
    def deviations(self) -> np.ndarray:
        """Standard deviations on the scale of the fit, shape (n,)."""
        return np.sqrt(np.diag(self.covariance))

    def interval(self, level: float = 0.9) -> np.ndarray:
        """Two-sided confidence intervals, shape (n, 2)."""
        reach = special.ndtri(0.5 + 0.5 * level) * self.deviations
        ends = np.stack([self.scaled - reach, self.scaled + reach], axis=1)
        return np.array([unscaled(self.study.laws[name], pair) for name, pair in zip(self.names, ends, strict=True)])

    def law(self, name: str) -> Law:
        """The proposed law of a number: normal, within its admissible range, or log-normal."""
        place = self.names.index(name)
        middle, std = float(self.scaled[place]), float(self.deviations[place])
        if self.study.laws[name].kind in LOGARITHMIC:
            return Law("lognormal", (middle, std))
        quantity = self.study.numbers[name].quantity
        low, high = middle - LAW_WIDTH * std, middle + LAW_WIDTH * std
        if quantity.above is not None:
            low = max(low, quantity.above + INSIDE * (middle - quantity.above))
        if quantity.at_least is not None:
            low = max(low, quantity.at_least)
        if quantity.below is not None:
            high = min(high, quantity.below - INSIDE * (quantity.below - middle))
        if quantity.at_most is not None:
            high = min(high, quantity.at_most)
        bounds = (quantity.above, quantity.at_least, quantity.below, quantity.at_most)
        if all(bound is None for bound in bounds):
            return Law("normal", (middle, std))
        return Law("truncated_normal", (middle, std, low, high))

    def correlations(self) -> dict[str, float]:
        """Rank correlations of the estimates by pair, as ``[correlation]`` has them."""
        linear = self.covariance / np.outer(self.deviations, self.deviations)
        return {
            f"{one}, {other}": float(6.0 / math.pi * math.asin(0.5 * linear[i, j]))
            for i, one in enumerate(self.names)
            for j, other in enumerate(self.names[:i])
        }

    def table(self) -> dict[str, Any]:
        """The proposal as entries of a study file; a number in a list comes with the whole list."""
        table: dict[str, Any] = {}
        for name in self.names:
            law, above = self.law(name), enclosing_list(self.study.table, name)
            if above and not has_dotted(table, above[0]):
                set_dotted(table, above[0], copy.deepcopy(above[1]))
            set_dotted(table, name, {law.kind: list(law.arguments)})
        pairs = self.correlations()
        return table | ({"correlation": pairs} if pairs else {})

    def toml(self) -> str:
        """The proposal as TOML, one line for each entry."""
        return toml_entries(self.table())

    def summary(self) -> dict[str, Any]:
        """For JSON."""
        numbers = {}
        for name, value, ends in zip(self.names, self.estimates, self.interval(), strict=True):
            law = self.law(name)
            numbers[name] = {
                "unit": self.study.numbers[name].quantity.unit,
                "estimate": float(value),
                "interval_90": [float(end) for end in ends],
                "prior": str(self.study.laws[name]),
                "law": {law.kind: list(law.arguments)},
            }
        return {
            "study": self.study.name,
            "samples": self.samples,
            "replayed": list(self.replayed),
            "numbers": numbers,
            "correlation": self.correlations(),
            "noise": self.noise,
            "noise_unit": {channel: units.output for channel, units in zip(self.noise, self.study.units, strict=True)},
            "residual_orders": self.orders,
            "kept": {name: width if math.isfinite(width) else None for name, width in self.kept.items()},
            "toml": self.toml(),
        }


def combination(names: Sequence[str], direction: np.ndarray) -> str:
    """A direction in the space of the numbers, in words."""
    direction = direction * np.sign(direction[np.argmax(np.abs(direction))])
    terms = [(name, float(x)) for name, x in zip(names, direction, strict=True) if abs(x) >= 0.1]
    if len(terms) == 1:
        return terms[0][0]
    return " ".join(f"{x:+.2f} {name}" for name, x in terms) + ", each in standard deviations of its law"


def require_identifiable(names: Sequence[str], information: np.ndarray) -> None:
    """Require that the flight tells every combination of the numbers better than their laws do.

    Args:
        names: The numbers.
        information: Their information matrix, in prior widths.

    Raises:
        NotIdentifiable: a number or a combination is not told.
    """
    diagonal = np.diag(information)
    for name, own in zip(names, diagonal, strict=True):
        if own <= 1e-24 * max(float(diagonal.max()), 1e-300) or not math.isfinite(own):
            raise NotIdentifiable(f"the flight does not tell {name}: the predicted output does not depend on it")
    root = np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(information / np.outer(root, root))
    if values[0] < SINGULAR_INFORMATION:
        direction = vectors[:, 0] / root
        text = combination(names, direction / np.linalg.norm(direction))
        raise NotIdentifiable(f"the flight does not tell {text}: the information matrix is singular in this direction")
    values, vectors = np.linalg.eigh(information)
    if values[0] < 1.0:
        text = combination(names, vectors[:, 0])
        raise NotIdentifiable(
            f"the flight does not tell {text}: the standard deviation along it is {values[0] ** -0.5:.3g} times "
            "that of the law"
        )


def numbers_to_fit(study: Study, wanted: Sequence[str]) -> list[str]:
    """The numbers to estimate; without a request those with laws that show in the output.

    Raises:
        ConfigError: a number has no law, or one of single cases, or there is none.
    """
    for name in wanted:
        if name not in study.laws:
            raise ConfigError("--number", f"'{name}' has no law in this study; {nearest(name, list(study.laws))}")
        if study.laws[name].kind in CASES:
            raise ConfigError("--number", f"'{name}' has a law of single cases, which has no derivative")
    names = list(wanted) or [
        name
        for name, law in study.laws.items()
        if name.split(".")[0] in PLANT_SLOTS and law.kind not in CASES and name.split(".")[-1] not in RANDOM
    ]
    if not names:
        raise ConfigError(study.source, f"has no law of {', '.join(PLANT_SLOTS)}: give a number a law to be fitted")
    return names


def sampled_log(study: Study, log: FlightLog) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Measured outputs and commands of every channel at the samples, shape (channels, samples).

    A command that was not logged is that of the analysed controller for the logged outputs.

    Returns:
        Outputs, commands, and the channels whose commands are replayed.

    Raises:
        ConfigError: the log has no measured output within the study's duration, or a command can be neither read nor
            replayed.
    """
    loop = study.loop
    samples = min(loop.steps, int(np.floor((last_time(log) - log.start) / loop.sample_time + 0.5)) + 1)
    references = study_references(study, max(samples, 1))
    outputs, commands, replayed = [], [], []
    for row, channel in enumerate(loop.channels):
        own = {
            name: nearest_values(log.columns[signal], log.start, loop.sample_time, max(samples, 1))
            for name in LOGGED
            if (signal := signal_name(channel, name)) in log.columns
        }
        y = own.get("y", np.full(max(samples, 1), np.nan))
        if channel in loop.plant.angles:
            desired = references[row, 0]
            y = desired + np.asarray(wrap_angle(y - desired))
        outputs.append(y)
        command = own.get("u_total")
        if command is not None and np.isfinite(command).any():
            commands.append(forward_filled(command))
            continue
        answer = replayed_channel(study, row, own | ({"y": y} if "y" in own else {}), references[row])
        if isinstance(answer, str):
            raise ConfigError(log.name, f"has no command {signal_name(channel, 'u_total')}, and {answer}")
        commands.append(answer)
        replayed.append(channel)
    logged = np.stack(outputs)
    if np.isfinite(logged).sum() < LEAST_SAMPLES:
        raise ConfigError(log.name, f"has fewer than {LEAST_SAMPLES} values of the output y at the study's samples")
    return logged, np.stack(commands), tuple(replayed)


def fit_log(
    study: Study,
    log: FlightLog,
    names: Sequence[str] = (),
    predictions: dict[tuple[str, ...], Prediction] | None = None,
) -> Fitted:
    """Estimate numbers of a study from a logged flight.

    Args:
        study: The study; its sweep is ignored.
        log: The flight, with measured outputs, and with commands, unless a replay can tell them.
        names: The numbers; none: all with laws that show in the output, without those that the flight does not tell.
        predictions: Compiled predictions to use again, by names, for logs of one length.

    Raises:
        ConfigError: a name or the log is not suitable.
        NotIdentifiable: the flight does not tell the numbers.

    Example:
        >>> import dssc_jax as dj
        >>> from dssc_jax.study.flight_logs import Column
        >>> study = dj.Study.load("motor")
        >>> run = dj.simulate(study, 3)
        >>> columns = {name: Column(run["t"].values, run[name].values) for name in ("y", "u_total")}
        >>> fitted = fit_log(study, dj.FlightLog("run", columns, 0.0), ["unmodelled.mu"])
        >>> fitted.law("unmodelled.mu").kind
        'lognormal'
    """
    study = study.without_sweep()
    chosen, cache = numbers_to_fit(study, names), {} if predictions is None else predictions
    logged, commands, replayed = sampled_log(study, log)
    kept: dict[str, float] = {}
    while True:
        key = tuple(chosen)
        if key not in cache:
            cache[key] = prediction(study, key, logged.shape[1])
        problem = FitProblem(study, key, cache[key], logged, commands)
        at, information = reweighted_fit(problem)
        alone = np.sqrt(np.diag(information))
        unidentified = [] if names else [name for name, own in zip(key, alone, strict=True) if not own > 1.0]
        if not unidentified:
            break
        kept |= {
            name: math.inf if own == 0.0 else float(1.0 / own)
            for name, own in zip(key, alone, strict=True)
            if name in unidentified
        }
        chosen = [name for name in chosen if name not in unidentified]
        if not chosen:
            raise NotIdentifiable(
                f"the flight tells none of {', '.join(kept)}: their laws are narrower than what it leaves open"
            )
    require_identifiable(key, information)
    widths = problem.widths * widening(problem, at)
    covariance = np.linalg.inv(information) * np.outer(widths, widths)
    channels = study.loop.channels
    left = problem.residuals(at)[0]
    return Fitted(
        study, key, problem.values(at), problem.middles + at * problem.widths, covariance,
        dict(zip(channels, np.sqrt(np.nanmean(left**2, axis=1)).tolist(), strict=True)),
        dict(zip(channels, (len(own) for own in problem.filters), strict=True)),
        kept, int(np.isfinite(logged).sum()), replayed,
    )  # fmt: skip
