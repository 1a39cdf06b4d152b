"""Integrals of software on board, such as an inner loop's, in a logged flight that begins in the air.

In such a flight, the integrals compensate errors of the believed mass, the wind and the drag already. A study whose
integrals start at 0 falls or drifts at first, which the flight did not, and a fit explains that by another mass.
"""

import math

import numpy as np

from dssc_jax.flight_logs.reading.reader import FlightLog, signal_name
from dssc_jax.flight_logs.signal_warnings import Hint
from dssc_jax.study import Study

LONG_IN_AIR = 1.0  # s before the study begins: integrals are no longer those of the ground
MOVING = 0.5  # m/s at the beginning: such a vehicle has flown before


START = ("plant.initial.0", "plant.initial.1")
"""The numbers of the first output and its derivative of a plant of one channel."""


def fixed_start(study: Study) -> tuple[float, float] | None:
    """The output and its derivative with which a plant of one channel starts; None if the study lacks such numbers."""
    values = []
    for name in START:
        number = study.numbers.get(name)
        if number is None or number.expression is not None or not isinstance(number.value, int | float):
            return None
        values.append(float(number.value))
    is_start_of_output = study.numbers[START[0]].quantity.unit.startswith(study.units[0].output)
    return (values[0], values[1]) if is_start_of_output else None


def fixed_integrals(study: Study) -> dict[str, float]:
    """The first values of the integrals of software on board, by name, without integrals that have a law."""
    software = study.loop.mimo_plant.software
    names = () if software is None else software.integrals(study.template.plant)
    initial_values = {}
    for name in names:
        number = study.numbers.get(f"plant.{name}")
        if number is not None and number.expression is None and isinstance(number.value, int | float):
            initial_values[number.name] = float(number.value)
    return initial_values


def begins_in_air(study: Study) -> bool:
    """Whether integrals of software on board start elsewhere than at 0, as in a flight under way."""
    software = study.loop.mimo_plant.software
    if software is None:
        return False
    names = software.integrals(study.template.plant)
    initial_values = fixed_integrals(study)
    return is_settled(study) or any(initial_values.values()) or len(initial_values) < len(names)


def begins_level(study: Study) -> bool:
    """Whether a vehicle begins without a tilt, whatever the wind."""
    software = study.loop.mimo_plant.software
    if software is None or is_settled(study):
        return False
    tilts = [study.numbers.get(f"plant.{name}") for name in ("roll", "pitch")]
    return all(number is None or number.value == 0.0 for number in tilts)


def start_remedy(study: Study, name: str) -> str:
    """The remedy, in words, for integrals that start at other values than in the study.

    Args:
        study: The study, whose plant has software on board.
        name: Name of one of the integrals, such as ``plant.inner_loop.velocity_integral.2``.
    """
    section, field, _ = name.rsplit(".", 2)
    laws = f"{field} = [0.0, 0.0, {{ normal = [0.0, 1.0] }}] in [{section}]"
    if is_settled(study):
        return (
            "The vehicle was not yet in the equilibrium from which the study starts, or noise in its commands moves "
            f"it: give the integrals laws, such as {laws}, which a fit estimates, begin the log later, or at the "
            f"take-off without {section}.start"
        )
    return (
        f"Begin at the take-off, set {section}.start = 'settled' for a vehicle that hovers in still air or in a steady "
        f"wind, or give the integrals laws, such as {laws}, which a fit estimates"
    )


def is_settled(study: Study) -> bool:
    """Whether the plant has software on board whose integrals start in the equilibrium."""
    software = study.loop.mimo_plant.software
    return software is not None and software.settled(study.template.plant)


def start_hints(study: Study, log: FlightLog) -> dict[str, Hint]:
    """The hint that the study's integrals start at 0 while the log begins in the air, by the name of the integrals."""
    initial_values = fixed_integrals(study)
    if not initial_values or is_settled(study) or any(initial_values.values()):
        return {}
    reason = airborne_reason(study, log)
    if not reason:
        return {}
    vertical = list(initial_values)[-1]
    text = f"starts at 0, as after a take-off, and {reason}. {start_remedy(study, vertical)}"
    return {vertical.rpartition(".")[0]: Hint("start-in-air", text)}


def airborne_reason(study: Study, log: FlightLog) -> str:
    """Why a vehicle seems to be in the air where the study begins; empty if nothing suggests it."""
    for segment in log.airborne:
        if segment.begin + LONG_IN_AIR < log.start < segment.end:
            return f"at {log.start:g} s the vehicle has been airborne for {log.start - segment.begin:.3g} s"
    speeds = []
    for channel in study.loop.channels:
        column = log.columns.get(signal_name(channel, "y_dot"))
        if column is not None and channel not in study.loop.plant.angles:
            row = int(np.searchsorted(column.time, log.start - 0.5 * study.loop.sample_time))
            speeds.append(float(column.value[min(row, len(column.value) - 1)]))
    speed = math.hypot(*speeds)
    return f"the log begins at a speed of {speed:.3g} m/s" if speed > MOVING else ""
