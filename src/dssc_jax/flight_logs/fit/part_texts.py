"""What a part that a study lacks is, in words: its size with the standard deviation, and a force as an acceleration."""

from dssc_jax.flight_logs.fit.least_squares import FitProblem
from dssc_jax.flight_logs.fit.part_fits import PartFit

GAIN = "plant.k_p"
"""The gain of the plant in normal form, [unit of the output/(s^2 unit of the command)]."""


def acceleration_text(problem: FitProblem, fit: PartFit) -> str:
    """The acceleration that the plant's gain makes of a force, in words; empty if the plant has no such gain.

    Args:
        problem: The problem of one channel.
        fit: The fit with the force.
    """
    number = problem.study.numbers.get(GAIN)
    gain = problem.named_values(fit.x).get(GAIN, None if number is None else number.value)
    if problem.study.table["plant"].get("kind") != "normal_form" or not isinstance(gain, float | int):
        return ""
    unit = problem.study.units[0].of("y/s^2")
    return f", or {gain * fit.size:.3g} ± {abs(gain) * fit.deviation:.2g} {unit} as an acceleration"


def part_text(problem: FitProblem, fit: PartFit) -> str:
    """What a part is, in words.

    Args:
        problem: The problem of one channel.
        fit: The fit with the part.
    """
    units = problem.study.units[0]
    return fit.part.words.format(
        size=fit.size,
        deviation=fit.deviation,
        acceleration=acceleration_text(problem, fit),
        percent=100.0 * abs(fit.size),
        verb="falls" if fit.size > 0.0 else "rises",
        output=units.output,
        command=units.command,
    )
