"""Controllers and differentiators under the same noise at the same sampling periods, with five costs."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.noise.costs import Costs, cubic, distortion, held, rms, variation
from benchmarks.noise.forms import CASE_2, NOISE
from dssc_jax.analyses.comparison import controller_table
from dssc_jax.core.contracts import Differentiator
from dssc_jax.core.signals import Measurement
from dssc_jax.models.differentiators import DIFFERENTIATORS
from dssc_jax.models.differentiators.high_gain_observer import HighGainParams
from dssc_jax.models.differentiators.lead_filter import LeadFilterParams
from dssc_jax.models.differentiators.levant import LevantParams
from dssc_jax.runs.trajectory import recorder

PERIODS = (0.001, 0.005, 0.02, 0.05)
DISTURBANCE = {"kind": "sine", "amplitude": 0.5, "period": 20.0}
CONTEST = {
    "draws": 4,
    "loop.duration": 80.0,
    "plant.initial": [0.0, 0.0],
    "reference": {"kind": "zero"},
    "disturbance": DISTURBANCE,
    "sensor": {"kind": "noisy", "velocity_std": NOISE},
    "requirement": [],
    "controller.predictor_start": "matched",
    "controller.functions": {"kind": "approx_sta_2", "kappa1": 2.0, "kappa2": 1.0, "delta": 0.2, "tau_av": 0.03},
}
CONTROLLERS = {
    "dssc_implicit": "DSSC, implicit",
    "dssc_conservative": "DSSC, conservative",
    "ssc": "SSC",
    "pi": "PI",
    "sta_explicit": "STA, explicit",
    "sta_implicit": "STA, implicit",
    "sta_proper": "STA, proper",
    "vgsta": "VGSTA, implicit",
    "smc": "first-order sliding mode",
}
AFTER = 40.0


def controller_costs(name: str, period: float) -> Costs:
    """Costs of a controller: the error e, and the command u that shall cancel the disturbance; means over draws."""
    study = CASE_2.override({**CONTEST, "loop.sample_time": period})
    study = study.override({"controller": controller_table(study, name)})
    fly = recorder(study)
    return Costs(*np.mean([costs_of(fly(draw, {}), period) for draw in range(CONTEST["draws"])], axis=0))


def costs_of(run: Any, period: float) -> Costs:
    """Costs of one trajectory."""
    kept = run.where(run["t"] >= AFTER, drop=True)
    times, error, u = (kept[name].values for name in ("t", "e", "u"))
    slope = (kept["sigma"] - run.attrs.get("l0", 0.2) * kept["e"]).values
    return Costs(
        rms(error),
        rms(cubic(error, slope, period)),
        float(np.abs(error).max()),
        variation(times, u),
        distortion(times, u, 1.0 / DISTURBANCE["period"]),
    )


SIGNAL = 0.25  # Hz, of sin: |y''| <= 2.47 m/s^2
RATIO = 30.0  # dB, of the powers of signal and noise
DURATION, SETTLED = 40.0, 8.0  # s
LIPSCHITZ = (2.0 * np.pi * SIGNAL) ** 2
FAMILIES: dict[str, Callable[[Any], Any]] = {
    "lead_filter": LeadFilterParams,
    "high_gain_observer": HighGainParams,
    "levant": LevantParams,
}
SCALES = {
    "lead_filter": np.geomspace(1e-3, 1.0, 41),
    "high_gain_observer": np.geomspace(1e-3, 1.0, 41),
    "levant": LIPSCHITZ * np.geomspace(0.1, 100.0, 41),
}
NAMES = {
    "difference": "backward difference",
    "lead_filter": "lead filter, tau_f [s]",
    "high_gain_observer": "high-gain observer, epsilon [s]",
    "levant": "Levant, implicit, L [m/s^2]",
}


@partial(jax.jit, static_argnums=(0, 1))
def estimates(model: Differentiator, params: Callable[[Any], Any], scales: jax.Array, y: jax.Array, dt: jax.Array):
    """y' as the differentiator estimates it, shape (scales, samples)."""

    def run(scale: jax.Array) -> jax.Array:
        def sample(state: Any, y: jax.Array) -> tuple[Any, jax.Array]:
            state, read = model.step(params(scale), state, Measurement(y, 0.0), dt)
            return jax.tree.map(lambda x: jnp.asarray(x, float), state), read.y_dot

        start = model.init(params(scale), Measurement(y[0], 0.0))
        return jax.lax.scan(sample, jax.tree.map(lambda x: jnp.asarray(x, float), start), y)[1]

    return jax.vmap(run)(scales)


def differentiator_costs(name: str, period: float) -> tuple[float, Costs]:
    """The parameter with the smallest L2 cost on one realisation of the noise, and its costs on another."""
    times = period * np.arange(round(DURATION / period))
    y, noise = np.sin(2.0 * np.pi * SIGNAL * times), np.sqrt(0.5 / 10 ** (RATIO / 10))
    train, test = (y + noise * np.random.default_rng(seed).standard_normal(y.size) for seed in (1, 2))
    if name == "difference":
        return np.nan, estimate_costs(times, np.diff(test, prepend=test[0]) / period)
    model = DIFFERENTIATORS[name].members[None]
    with jax.enable_x64(True):
        fly = partial(estimates, model, FAMILIES[name])
        tried = np.asarray(fly(SCALES[name], train, period))
        best = int(np.argmin([estimate_costs(times, row).l2 for row in tried]))
        return SCALES[name][best], estimate_costs(
            times, np.asarray(fly(SCALES[name][best : best + 1], test, period))[0]
        )


def slope_of(times: np.ndarray) -> np.ndarray:
    """The true y'."""
    return 2.0 * np.pi * SIGNAL * np.cos(2.0 * np.pi * SIGNAL * times)


def estimate_costs(times: np.ndarray, estimate: np.ndarray) -> Costs:
    """Costs of an estimate of y'."""
    kept = times >= SETTLED
    times, estimate = times[kept], estimate[kept]
    error = estimate - slope_of(times)
    inside, between = held(times, estimate)
    return Costs(
        rms(error),
        rms(between - slope_of(inside)),
        float(np.abs(error).max()),
        variation(times, estimate),
        distortion(times, estimate, SIGNAL),
    )
