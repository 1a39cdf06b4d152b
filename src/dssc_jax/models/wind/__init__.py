"""Registry of winds: velocity of the air in the inertial frame, z up; a family is one file."""

from dssc_jax.core.contracts import NoParams
from dssc_jax.core.default_functions import stateless, unchanged, unchanging
from dssc_jax.core.registry import Registry, single
from dssc_jax.core.vectors import Vec3
from dssc_jax.core.wind import Wind, WindBounds
from dssc_jax.models.wind.bounded import BOUNDED_WIND
from dssc_jax.models.wind.dryden import DRYDEN
from dssc_jax.models.wind.prescribed import CONSTANT_WIND, GUST, PIECEWISE, SPLINE_WIND
from dssc_jax.models.wind.record import RECORDED_WIND

NO_WIND = Wind(
    NoParams,
    stateless,
    unchanged,
    lambda params, state, t: Vec3(0.0, 0.0, 0.0),
    bounds=lambda params: WindBounds(0.0, 0.0, 0.0),
    last_change=unchanging,
)

WINDS: Registry = {
    "none": single(NO_WIND, "no wind"),
    "constant": single(CONSTANT_WIND, "a constant velocity from a given time on", x=2.0, y=1.0, z=0.0),
    "piecewise": single(
        PIECEWISE, "a table of velocities with jumps", times=[0.0, 0.5], x=[1.0, 2.0], y=[0.0, 1.0], z=[0.0, 0.0]
    ),
    "gust": single(GUST, "a 1-cosine gust on a constant mean", x=2.0, y=0.0, z=0.5, duration=1.0),
    "spline": single(
        SPLINE_WIND,
        "cubic splines of given knots: any wind of bounded speed and acceleration",
        interval=0.3,
        x=[1.0, 2.0],
    ),
    "record": RECORDED_WIND,
    "bounded": single(
        BOUNDED_WIND,
        "all winds within bounds: a draw switches between extremes at random times",
        speed=5.0,
        vertical=2.0,
        rate=4.0,
        period=0.5,
    ),
    "dryden": single(
        DRYDEN,
        "mean wind and Dryden turbulence of MIL-F-8785C at low altitude, exactly sampled",
        speed=5.0,
        altitude=10.0,
        airspeed=5.0,
    ),
}
