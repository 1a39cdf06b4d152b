"""Predict chattering by describing functions: the limit cycle of a switching law and a lag.

The harmonic balance is -1/W(i w) = N(A, w). W is the transfer function from the robust command to sigma. N is the
describing function of the law for sigma = A sin(w t): for the relay 4 K/(pi A); for the STA, c kappa1 A^(-1/2) for its
root plus 2 kappa2/(pi A)/(i w) for its integrated relay. With a lag of order 2 and mu max(a_p, l_0) << 1, the amplitude
grows as mu with the relay and as mu^2 with the STA, and the frequency falls as 1/mu.

References:
    D. P. Atherton, Nonlinear Control Engineering (1975).
    I. Boiko, L. Fridman, "Analysis of chattering in continuous sliding-mode controllers", IEEE Trans. Automatic Control
    50 (2005) 1442-1446.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax
import numpy as np
from scipy.optimize import brentq

from dssc_jax.analyses.theory.linearised import Linearised, at_rest, open_loop, require_continuous_dynamics
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.harmonic_balance import HarmonicBalance
from dssc_jax.engine.batching import medians
from dssc_jax.engine.plain import plain_options
from dssc_jax.study import Study
from dssc_jax.study.actuators import kind_in

SPAN = 1e4  # highest scanned frequency over the fastest pole's, and the fastest pole's over the lowest scanned
SCANNED = 400  # number of frequencies scanned


class LimitCycle(NamedTuple):
    """The oscillation sigma = A sin(w t) that a switching law and unmodelled dynamics sustain.

    Args:
        amplitude: A, in the unit of sigma, output/s.
        frequency: w [rad/s].
    """

    amplitude: float
    frequency: float


def limit_cycle(study: Study, point: Mapping[str, float] | None = None) -> LimitCycle | None:
    """Predict the chattering of a loop by the describing function of its controller; None if none is predicted.

    Args:
        study: A study on a plant of one channel whose controller declares its describing function (``smc``, ``sta``),
            with a lag or without unmodelled dynamics.
        point: Values of some numbers by dotted name; all other numbers have the study's values, or the medians of
            their laws.

    Raises:
        ConfigError: The law's describing function is not known, or the unmodelled dynamics have no form in continuous
            time.
    """
    return limit_cycles(study, [point or {}])[0]


def limit_cycles(study: Study, points: Sequence[Mapping[str, float]]) -> list[LimitCycle | None]:
    """Predict the limit cycle at each of several points, by one compiled program; None where there is none.

    Args:
        study: The study, as for :func:`limit_cycle`.
        points: For each point, values of some numbers by dotted name, as for :func:`limit_cycle`.

    Raises:
        ConfigError: The law's describing function is not known, or the unmodelled dynamics have no form in continuous
            time.
    """
    resting = at_rest(study)
    describing = resting.loop.controller[0].describing
    if describing is None:
        rule = f"the describing function of '{kind_in(resting.config, 'controller')}' is not known"
        raise ConfigError(f"{study.source}: controller.kind", rule)
    require_continuous_dynamics(resting, resting.loop.unmodelled[0])
    compiled_open_loop = jax.jit(
        lambda lane: open_loop(resting.loop, resting.params(lane)), compiler_options=plain_options()
    )
    middle = medians(resting)
    cycles = []
    for point in points:
        values = {**middle, **point}
        with jax.enable_x64(True):
            response = jax.tree.map(np.asarray, compiled_open_loop(values))
        balance = describing(resting.params(values).controller[0])
        cycles.append(solve_balance(response, balance))
    return cycles


def solve_balance(response: Linearised, balance: HarmonicBalance) -> LimitCycle | None:
    """Solve the harmonic balance for the limit cycle of the highest frequency, at which chattering settles.

    A scan of frequencies brackets the solutions. A root search refines the solution with the highest frequency.

    Args:
        response: The linear loop from the robust command to sigma.
        balance: The harmonic balance of the switching law.

    Returns:
        The limit cycle; None if the balance has no solution in the scan.
    """

    def negative_inverse(w: float) -> complex:
        """-1/W(i w) at the frequency w [rad/s], with the transfer function W of the linear loop."""
        gain = response.c @ np.linalg.solve(1j * w * np.eye(len(response.a)) - response.a, response.b)
        return complex(-1.0 / gain)

    def residual(w: float) -> float:
        """Residual of the harmonic balance at the frequency w [rad/s], with the amplitude that solves its real part.

        NaN if no amplitude does.
        """
        q = negative_inverse(w)
        return balance.residual(q, balance.amplitude(q), w) if q.real > 0.0 else math.nan

    fastest_pole = np.abs(np.linalg.eigvals(response.a)).max()  # [rad/s]
    frequencies = np.geomspace(fastest_pole / SPAN, fastest_pole * SPAN, SCANNED)
    residuals = np.array([residual(w) for w in frequencies])
    crossings = np.flatnonzero(residuals[:-1] * residuals[1:] < 0.0)
    if not crossings.size:
        return None
    low = frequencies[crossings[-1]]
    high = frequencies[crossings[-1] + 1]
    frequency = float(brentq(residual, low, high, xtol=1e-12 * high))  # type: ignore[arg-type]
    return LimitCycle(float(balance.amplitude(negative_inverse(frequency))), frequency)
