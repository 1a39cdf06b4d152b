"""Sampled forms of DSSC with and without noise: where they rest, how exact they are, how fast they must sample."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import dssc_jax as dj
from dssc_jax.core.registry import Discretisation
from dssc_jax.core.signals import Measurement, ReferencePoint
from dssc_jax.models.controllers.dssc import DSSC

ROOT = Path(__file__).parents[2]
CASE_2 = dj.Study.load(ROOT / "studies" / "paper_case2.toml")
NOISE = 0.06  # m/s, on the velocity
FAST = (0.0005, 0.001, 0.005, 0.02)
FORMS = ("implicit", "conservative")
SAMPLED = (("implicit", "matched"), ("conservative", "matched"), ("implicit", "midpoint"), ("conservative", "midpoint"))
WIDE = 15.0  # m/s, a bound of the command that noise of this size does not reach
STILL = {"disturbance.value": 0.0}
KAPPA_1, KAPPA_2 = 2.0 / (110.651 * 0.002), 2.0 / (110.651 * 0.002 * 4.0166)
ROWS: dict[str, dict[str, Any]] = {
    "square_root": {"kappa_o": 110.651, "kappa_m": 4.0166, "delta_o": 1.0, "delta_m": 1.0, "tau_av": 0.002},
    "approx_sta_1": {"kappa1": KAPPA_1, "kappa2": KAPPA_2, "delta": 1.0, "tau_av": 0.002},
    "approx_sta_2": {"kappa1": KAPPA_1, "kappa2": KAPPA_2, "delta": 0.1, "tau_av": 0.002},
    "field": {"k_o": 10.0, "kappa1": 1.0, "kappa2": 0.5, "delta": 0.1},
    "vgsta": {
        "phi_a": 0.1,
        "phi_b": 2.0,
        "kappa_a": 0.3,
        "kappa_b": 0.05,
        "kappa_c": 0.8,
        "kappa_d": 0.5,
        "epsilon": 0.3,
        "gamma": 0.5,
        "delta": 0.5,
        "tau_av": 0.03,
    },
}
"""Case 2's functions with the filter of the study of differentiators, and rows of a like size of gain."""
STEPS = 20_000


def case(row: str, form: str, sample_time: float, noise: float = 0.0, **changes: Any) -> dj.Study:
    """Case 2, x axis, started at sliding, with a row of functions and noise on the velocity."""
    sensor = {"sensor": {"kind": "noisy", "velocity_std": noise}} if noise else {}
    return CASE_2.override(
        {
            "controller.predictor_start": "matched",
            "controller.rho": WIDE,
            "controller.functions": {"kind": row, **ROWS[row]},
            "controller.discretisation": form,
            "loop.sample_time": sample_time,
            "metrics": {"after": 40.0, "names": ["error_max", "command_tv", "outside_sliding"]},
            "requirement": [],
            **sensor,
            **changes,
        }
    )


class Rest(NamedTuple):
    """Medians over draws of the largest |e| after 40 s [m], and of the command's total variation then [m/s]."""

    error: float
    variation: float


def rest(study: dj.Study, draws: int) -> Rest:
    """Where the loop rests."""
    found = dj.run(study.override({"draws": draws})).dataset
    return Rest(float(found["error_max"].median()), float(found["command_tv"].median()))


class Rests(NamedTuple):
    """The loop at rest with a row of functions at one T_s: the first five without disturbance, the others with it.

    Args:
        quiet: Without noise.
        implicit: With noise.
        conservative: With noise.
        floor: Standard deviation of e [m] in any loop that holds the measured sigma at 0: that of white noise of the
            velocity behind 1/(s + l_0), s (T_s/(2 l_0))^(1/2).
        predicted: |e| [m] at which the implicit form's drift balances its integral action.
        quiet_disturbed: Without noise, with Case 2's disturbance.
        disturbed: Conservative form with noise and Case 2's disturbance.
        tight: The same with Case 2's own rho.
    """

    quiet: Rest
    implicit: Rest
    conservative: Rest
    floor: float
    predicted: float
    quiet_disturbed: Rest
    disturbed: Rest
    tight: Rest


def rests(row: str, sample_time: float, draws: int) -> Rests:
    """Where the loop with a row of functions rests."""
    implicit, conservative = FORMS
    noisy = case(row, implicit, sample_time, NOISE, **STILL)
    return Rests(
        rest(case(row, implicit, sample_time, **STILL), 1),
        rest(noisy, draws),
        rest(case(row, conservative, sample_time, NOISE, **STILL), draws),
        NOISE * (sample_time / (2.0 * float(noisy.template.controller[0].l0))) ** 0.5,
        dj.design.noise_drift(noisy)[""].error,
        rest(case(row, implicit, sample_time), 1),
        rest(case(row, conservative, sample_time, NOISE), draws),
        rest(case(row, conservative, sample_time, NOISE, **{"controller.rho": 1.5}), draws),
    )


def trajectory(row: str, form: str, start: str, sample_time: float) -> np.ndarray:
    """e at every 40 ms without noise."""
    study = case(row, form, sample_time, **{"controller.predictor_start": start})
    return dj.simulate(study, every=round(0.04 / sample_time))["e"].values[:1990]


def deviations(row: str, times: Sequence[float], finest: float) -> dict[tuple[str, str], list[float]]:
    """Largest distance of e to its limit without noise, by form and start, at each T_s."""
    limit = trajectory(row, *SAMPLED[2], finest)
    return {
        (form, start): [float(np.abs(trajectory(row, form, start, each) - limit).max()) for each in times]
        for form, start in SAMPLED
    }


@partial(jax.jit, static_argnums=0)
def swings(form: str, gains: Any, times: jax.Array, start: jax.Array) -> jax.Array:
    """Largest |sigma| late in a run of sigma' = u, by T_s; no disturbance, started at sliding."""
    member = DSSC.members[Discretisation(form)]
    at_rest = ReferencePoint(0.0, 0.0, 0.0)

    def run(dt: jax.Array) -> jax.Array:
        def sample(carry: Any, k: jax.Array) -> tuple[Any, jax.Array]:
            sigma, state = carry
            state, command, _ = member.step(gains, state, Measurement(0.0, sigma), at_rest, dt)
            after = sigma + dt * command.robust
            return (after, jax.tree.map(lambda x: jnp.asarray(x, float), state)), jnp.abs(sigma)

        state = member.init(gains, Measurement(0.0, start), at_rest)
        state = jax.tree.map(lambda x: jnp.asarray(x, float), state)
        _, sizes = jax.lax.scan(sample, (start, state), jnp.arange(STEPS))
        return jnp.max(sizes[-STEPS // 4 :])

    return jax.vmap(run)(times)


def largest_sample_time(row: str, form: str, start: float) -> float:
    """The largest T_s [s] at which sigma' = u, started at sliding, ends closer to 0 than it started."""
    gains = case(row, form, 0.005).template.controller[0]._replace(l0=0.2, nominal=None)
    low, high = 1e-3, 10.0
    with jax.enable_x64(True):
        for _ in range(3):
            times = np.geomspace(low, high, 65)
            settled = np.asarray(swings(form, gains, jnp.asarray(times), jnp.asarray(start))) < start
            last = int(np.flatnonzero(~settled)[0]) if not settled.all() else times.size - 1
            low, high = float(times[max(last - 1, 0)]), float(times[last])
    return low
