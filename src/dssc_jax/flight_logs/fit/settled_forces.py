"""Forces against the speed that a study lacks, fitted at the speed that they leave; friction may hold at rest, too.

A fit computes friction from the speed of the flight. At rest, the noise of that speed decides the direction of the
friction. If the vehicle sticks, friction at rest is the opposite of the other forces, up to the size of the friction.
"""

from functools import partial

import numpy as np

from dssc_jax.flight_logs.fit.flown_course import Flight, flown_with
from dssc_jax.flight_logs.fit.least_squares import TINY, FitProblem
from dssc_jax.flight_logs.fit.missing_parts import FRICTION, REST, Part
from dssc_jax.flight_logs.fit.part_fits import STRONG_EVIDENCE, FitWithoutPart, PartFit, fitted_part
from dssc_jax.flight_logs.fit.prediction import driving_forces

ROUNDS = 3  # of fits with a force against the speed, each at the speed of the one before


def sticking_forces(drive: np.ndarray, flight: Flight, size: float) -> np.ndarray:
    """Friction of a size, which holds a vehicle at rest against forces smaller than this size, shape (n,) [u].

    Args:
        drive: What actuator and disturbance exert, shape (n,) [u].
        flight: The flight.
        size: The size [u].
    """
    rest = REST * float(np.abs(flight.speed).max()) + TINY
    at_rest = np.exp(-((flight.speed / rest) ** 2))
    held = np.clip(drive, -size, size)
    return -at_rest * held - (1.0 - at_rest) * size * np.sign(flight.speed)


def sticking(drive: np.ndarray) -> Part:
    """Friction that also holds at rest.

    Args:
        drive: What actuator and disturbance exert, shape (n,) [u].
    """
    return FRICTION._replace(
        words="a force against the speed of constant size, which also holds at rest (friction, perhaps with sticking, "
        "{size:.3g} ± {deviation:.2g} {command}{acceleration})",
        forces=partial(sticking_forces, drive),
        leaves="sticking leaves a residual of its own, so that these sizes are rough, or another part acts beside it",
    )


def settled(problem: FitProblem, without: FitWithoutPart, flight: Flight, fit: PartFit) -> PartFit:
    """Repeat the fit of a force with the speed that the force leaves, as long as this explains the flight better.

    Friction is also fitted with sticking. A force that does not depend on the speed keeps its fit.

    Args:
        problem: The problem, with the noise of its minimum.
        without: The fit without a part.
        flight: The flight by the speed without the force.
        fit: The fit with the force at that speed.
    """
    best = settled_fit(problem, without, flight, fit)
    if fit.part is not FRICTION:
        return best
    drive = driving_forces(problem.study, problem.named_values(best.x), problem.log.commands)
    stuck = fitted_part(problem, without, flight, sticking(drive))
    if stuck is None:
        return best
    stuck = settled_fit(problem, without, flight, stuck)
    return stuck if stuck.gain > best.gain + STRONG_EVIDENCE else best


def settled_fit(problem: FitProblem, without: FitWithoutPart, flight: Flight, fit: PartFit) -> PartFit:
    """The fit of one force with the speed that the force leaves; the arguments are those of :func:`settled`."""
    for _ in range(ROUNDS if fit.part.has_speed else 0):
        forces = fit.part.forces_on(flight, fit.size)
        flight = flown_with(problem, fit.x, fit.part.commands(flight, fit.size)[None, :], forces)
        again = fitted_part(problem, without, flight, fit.part)
        if again is None or again.gain <= fit.gain:
            break
        fit = again
    return fit
