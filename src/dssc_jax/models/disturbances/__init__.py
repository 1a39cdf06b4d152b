"""Registry of matched disturbances d(y, y', t), added to the plant's command (7); a family is one file."""

from dssc_jax.core.contracts import Disturbance, NoParams, Variation
from dssc_jax.core.default_functions import stateless, unchanged, unchanging
from dssc_jax.core.registry import Registry, single
from dssc_jax.core.smoothness import SMOOTH
from dssc_jax.models.disturbances.noise import FILTERED_NOISE
from dssc_jax.models.disturbances.partition import PARTITION
from dssc_jax.models.disturbances.prescribed import CONSTANT, SINE_DISTURBANCE, SPLINE, STEP
from dssc_jax.models.disturbances.record import RECORDED_DISTURBANCE

NO_DISTURBANCE = Disturbance(
    NoParams,
    stateless,
    unchanged,
    lambda params, state, measurement, sigma, t: 0.0,
    variation=Variation.HELD,
    smooth=SMOOTH,
    last_change=unchanging,
)

DISTURBANCES: Registry = {
    "none": single(NO_DISTURBANCE, "no disturbance"),
    "constant": single(CONSTANT, "a constant", value=0.2),
    "step": single(STEP, "a step at a given time", value=0.2, at=0.3),
    "sine": single(SINE_DISTURBANCE, "amplitude sin(2 pi t/period + phase)", amplitude=0.2, period=1.0),
    "spline": single(
        SPLINE,
        "a cubic spline of given knots: any signal of bounded amplitude and slope",
        knots=[0.1, -0.1],
        interval=0.2,
    ),
    "record": RECORDED_DISTURBANCE,
    "filtered_noise": single(FILTERED_NOISE, "Gauss-Markov noise, exactly sampled", std=0.1, correlation_time=0.2),
    "partition": single(
        PARTITION,
        "d_1 + d_2 + d_3 of (30), attaining the bounds of (A1)-(A3)",
        k_d1=0.1,
        k_d4=0.2,
        alpha_d3=0.1,
        period=2.0,
    ),
}
