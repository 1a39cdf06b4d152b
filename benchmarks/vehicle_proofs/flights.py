"""Flights of a vehicle's problem in adversarial winds: does any signal leave its bound?

The loop is the package's own; the wind is chosen here at every sample, from the state of the vehicle too. A program is
compiled once for each structure of a loop, and takes every number of it from the lane.
"""

import dataclasses
import json
from collections.abc import Callable
from enum import IntEnum
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import dssc_jax as dj
from benchmarks.vehicle_proofs.problems import Columns, random_starts, random_vehicles, study_of
from dssc_jax.closed_loop.draw import conclude, initial_progress, is_running, sampler
from dssc_jax.closed_loop.metrics.instants import Instant
from dssc_jax.closed_loop.metrics.streaming import Measure, Metric, Scope, Window, final_value, peak_update
from dssc_jax.closed_loop.time_loops import until_all_ended
from dssc_jax.core.json_types import JsonObject
from dssc_jax.core.numerics import root_abs, uniforms
from dssc_jax.core.signals import Outcome, Scalar
from dssc_jax.core.vectors import Vec3
from dssc_jax.core.wind import Wind
from dssc_jax.engine.batching import Engine, Lane, evaluate, results_of
from dssc_jax.engine.sampling import draw_key
from dssc_jax.lanes.interface import AXIS
from dssc_jax.models.uav.plant import UavState
from dssc_jax.models.uav.vehicle import GRAVITY

LANES = 8192
FLIPS = 12
"""Changes of sign of a wind that is turned in time."""
STATIC = ("rotor_angles", "spins", "memory", "predictor_term", "wind", "reference")
"""Parts of the paths of parameters that a program cannot take from the lane, or that no flight changes."""
ROUNDED = 1.0 + 1e-9


class Policy(IntEnum):
    """How a wind is chosen; every one keeps the bounds and stays at their edge."""

    RANDOM = 0
    SWING = 1
    AGAINST = 2
    TURNED = 3


class Gust(NamedTuple):
    """What a flight's wind is made of.

    Args:
        policy: See :class:`Policy`.
        speed: Bound of the horizontal wind [m/s].
        vertical: Bound of the vertical wind [m/s].
        angle: Direction of a swing [rad]; against the motion: the angle between the motion and the wind.
        turn: Rate at which the direction turns [rad/s].
        period: Of a swing, or the mean time between two switches [s].
        phase: Of the swing, in periods.
        period_z: The same of the vertical wind [s].
        phase_z: Of the vertical swing, in periods.
        weight: Share of the position in the motion, with the velocity as the other part [1/s].
        side: Sign of the vertical wind.
        flips: Times at which a turned wind changes its sign [s].
        flips_z: The same of the vertical wind [s].
    """

    policy: Scalar
    speed: Scalar
    vertical: Scalar
    angle: Scalar
    turn: Scalar
    period: Scalar
    phase: Scalar
    period_z: Scalar
    phase_z: Scalar
    weight: Scalar
    side: Scalar
    flips: tuple[Scalar, ...]
    flips_z: tuple[Scalar, ...]


HELD = Wind(
    tuple,
    init=lambda params, key: Vec3(0.0, 0.0, 0.0),
    step=lambda params, state, key, t, dt: state,
    value=lambda params, state, t: state,
)
"""The wind that the adversary has put into the state of the loop."""


def plane_norm(x: Callable[[Instant], Scalar], y: Callable[[Instant], Scalar]) -> Callable[[Instant], Scalar]:
    """The norm of a vector of the plane."""
    return lambda instant: root_abs(x(instant) ** 2 + y(instant) ** 2)


def inner_measure(name: str, unit: str, of: Callable[[Instant], Scalar]) -> Measure:
    """The largest value of a signal within the vehicle that no metric of the package measures."""
    metric = Metric(unit, name, peak_update(of), final_value, scope=Scope.VEHICLE)
    return Measure(name, name, Window(0.0), None, metric)


INNER = (
    inner_measure("speed", "m/s", plane_norm(lambda i: i.channels[0].e_dot, lambda i: i.channels[1].e_dot)),
    inner_measure("alpha", "m/s^2", plane_norm(lambda i: GRAVITY * i.plant.theta, lambda i: GRAVITY * i.plant.phi)),
)
"""Norms of the plane, whose bounds a certificate has beside those of the statement."""


def sign_of(value: Scalar) -> Scalar:
    """1 or -1, never 0."""
    return jnp.where(value < 0.0, -1.0, 1.0)


def turned_sign(flips: tuple[Scalar, ...], t: Scalar) -> Scalar:
    """A sign that changes at given times."""
    sign = jnp.ones_like(flips[0])
    for flip in flips:
        sign = jnp.where(t >= flip, -sign, sign)
    return sign


def wind_at(gust: Gust, state: UavState, held: Vec3, t: Scalar, dt: float, key: jax.Array) -> Vec3:
    """The wind from a sample to the next one; its horizontal part and its vertical part are as large as they can be."""
    switch, spot, side = uniforms(key, 3)
    switches = (switch < dt / gust.period) | (t == 0.0)
    swing = sign_of(jnp.sin(2.0 * jnp.pi * (t / gust.period + gust.phase)))
    swing_z = sign_of(jnp.sin(2.0 * jnp.pi * (t / gust.period_z + gust.phase_z)))
    swing = jnp.where(gust.policy == Policy.TURNED, turned_sign(gust.flips, t), swing)
    swing_z = gust.side * jnp.where(gust.policy == Policy.TURNED, turned_sign(gust.flips_z, t), swing_z)
    motion = state.position * gust.weight + state.velocity
    length = root_abs(motion.x**2 + motion.y**2)
    moves = length > 0.0
    along = jnp.where(moves, motion.x / jnp.where(moves, length, 1.0), 1.0)
    across = jnp.where(moves, motion.y / jnp.where(moves, length, 1.0), 0.0)
    against = gust.policy == Policy.AGAINST
    random = gust.policy == Policy.RANDOM
    angle = jnp.where(random, 2.0 * jnp.pi * spot, gust.angle + gust.turn * t)
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    x = jnp.where(against, cos * along - sin * across, jnp.where(random, 1.0, swing) * cos)
    y = jnp.where(against, sin * along + cos * across, jnp.where(random, 1.0, swing) * sin)
    z = jnp.where(against, gust.side * sign_of(motion.z), jnp.where(random, sign_of(side - 0.5), swing_z))
    chosen = Vec3(gust.speed * x, gust.speed * y, gust.vertical * z)
    keeps = random & ~switches
    return Vec3(*(jnp.where(keeps, old, new) for old, new in zip(held, chosen, strict=True)))


def gust_names() -> list[str]:
    """Names of a gust's numbers as a lane has them."""
    single = [f"gust.{name}" for name in Gust._fields[:-2]]
    return single + [f"gust.{name}.{place}" for name in Gust._fields[-2:] for place in range(FLIPS)]


def gust_of(values: dict[str, jax.Array]) -> Gust:
    """A lane's gust."""
    numbers: dict[str, Any] = {name: values[f"gust.{name}"] for name in Gust._fields[:-2]}
    for name in Gust._fields[-2:]:
        numbers[name] = tuple(values[f"gust.{name}.{place}"] for place in range(FLIPS))
    return Gust(**numbers)


def parameters_of(study: dj.Study) -> tuple[dict[str, float], Any, list[str]]:
    """The parameters of a study's loop by path, the tree of them, and the paths in its order."""
    flat, tree = jax.tree_util.tree_flatten_with_path(study.template)
    paths = [jax.tree_util.keystr(path, simple=True, separator=".") for path, _ in flat]
    return dict(zip(paths, [leaf for _, leaf in flat], strict=True)), tree, paths


def free(paths: list[str]) -> list[str]:
    """Paths of parameters that differ between lanes."""
    return [path for path in paths if not any(part in path for part in STATIC)]


def lane_of(study: dj.Study) -> Lane:
    """A flight in an adversary's wind, with the lane's parameters."""
    leaves, tree, paths = parameters_of(study)
    loop = dataclasses.replace(study.loop, wind=HELD)
    measures = (*study.measures, *INNER)

    def lane(values: dict[str, jax.Array], index: jax.Array) -> dict[str, Scalar]:
        params = tree.unflatten([values.get(path, leaves[path]) for path in paths])
        gust = gust_of(values)
        key = draw_key(study.config.seed, index)
        sample = sampler(loop, params, key, measures, (), freeze=False)

        def advance(at: Any) -> Any:
            t = at.k * loop.sample_time
            fresh = jax.random.fold_in(key, at.k)
            wind = wind_at(gust, at.state.plant, at.state.wind, t, loop.sample_time, fresh)
            return sample(at._replace(state=at.state._replace(wind=wind)))[0]

        begin = initial_progress(loop, params, key, measures)
        end = until_all_ended(advance, partial(is_running, loop), begin, loop.steps, AXIS)
        return results_of(study, conclude(loop, measures, (), end))

    return lane


class Structure(NamedTuple):
    """What a program cannot take from the lane: the tree of parameters, static parameters, and the clock."""

    tree: Any
    fixed: tuple[tuple[str, float], ...]
    sample_time: float
    steps: int
    substeps: int


ENGINES: dict[Structure, Engine] = {}


def engine_of(study: dj.Study) -> Engine:
    """The program of a study's structure; it is compiled once."""
    leaves, tree, paths = parameters_of(study)
    names = free(paths)
    fixed = tuple((path, leaf) for path, leaf in leaves.items() if path not in names and not path.startswith("wind"))
    loop = study.loop
    structure = Structure(tree, fixed, loop.sample_time, loop.steps, loop.substeps)
    if structure not in ENGINES:
        ENGINES[structure] = Engine(study, LANES, program=lane_of, extra=(*names, *gust_names()))
    return ENGINES[structure]


@lru_cache(maxsize=64)
def response_times(problem: str, duration: float) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Times of the extrema of horizontal and of vertical signals after a gust that stays [s], of a problem as JSON.

    A wind with changes of sign at these times before its end is the worst one of a linear loop.
    """
    study = study_of(json.loads(problem), duration)
    speed, vertical = study.table["wind"]["speed"], study.table["wind"]["vertical"]
    constant = {"kind": "constant", "x": speed, "y": 0.0, "z": vertical}
    flown = dj.simulate(study.override({"wind": constant}))
    t = flown["t"].values
    plane = [extrema(t, flown[name].values) for name in ("x_e", "x_y_dot", "x_sigma", "theta", "rotor_1")]
    height = [extrema(t, flown[name].values) for name in ("z_e", "z_y_dot", "z_sigma", "thrust")]
    return plane, height


def extrema(t: np.ndarray, signal: np.ndarray) -> np.ndarray:
    """Times of a signal's extrema [s]."""
    slope = np.diff(signal)
    return t[1:-1][np.sign(slope[1:]) != np.sign(slope[:-1])]


def random_gusts(
    study: dj.Study, times: tuple[list[np.ndarray], list[np.ndarray]], count: int, rng: np.random.Generator
) -> Columns:
    """Gusts of every policy; see :func:`response_times`."""
    duration = study.loop.steps * study.loop.sample_time
    plane, height = times
    policy = rng.choice(len(Policy), count, p=[0.2, 0.3, 0.25, 0.25])
    against = policy == Policy.AGAINST
    quarter = 0.5 * np.pi * rng.integers(0, 4, count) + np.where(rng.random(count) < 0.3, rng.normal(0, 0.3, count), 0)
    direction = np.where(rng.random(count) < 0.5, 0.5 * np.pi * rng.integers(0, 4, count), rng.uniform(0, 7.0, count))
    turning = (rng.random(count) < 0.25) * rng.choice([-1.0, 1.0], count) * np.exp(rng.uniform(-3.0, 1.5, count))
    columns = {
        "policy": policy.astype(float),
        "speed": np.full(count, study.table["wind"]["speed"]),
        "vertical": np.full(count, study.table["wind"]["vertical"]),
        "angle": np.where(against, quarter, direction),
        "turn": np.where(against, 0.0, turning),
        "period": np.exp(rng.uniform(np.log(0.2), np.log(2.0 * duration), count)),
        "phase": rng.random(count),
        "period_z": np.exp(rng.uniform(np.log(0.2), np.log(2.0 * duration), count)),
        "phase_z": rng.random(count),
        "weight": np.where(rng.random(count) < 0.5, 0.0, rng.choice([-1.0, 1.0], count) * rng.exponential(1.0, count)),
        "side": rng.choice([-1.0, 1.0], count),
    }
    periods = resonant_periods(plane), resonant_periods(height)
    resonates = rng.random(count) < 0.5
    for name, found in zip(("period", "period_z"), periods, strict=True):
        near = rng.choice(found, count) * rng.uniform(0.7, 1.4, count)
        columns[name] = np.where(resonates & (policy == Policy.SWING), near, columns[name])
    gusts = {f"gust.{name}": column for name, column in columns.items()}
    for name, found in (("flips", plane), ("flips_z", height)):
        table = np.stack([flips_before(each, duration) for each in found])
        rows = table[rng.integers(0, len(found), count)]
        gusts |= {f"gust.{name}.{place}": rows[:, place] for place in range(FLIPS)}
    return gusts


def resonant_periods(times: list[np.ndarray]) -> np.ndarray:
    """Twice the time between extrema, of several signals [s]."""
    halves = np.concatenate([np.diff(np.concatenate([[0.0], each])) for each in times])
    halves = halves[halves > 0.05]
    return 2.0 * halves if len(halves) else np.array([4.0])


def flips_before(times: np.ndarray, duration: float) -> np.ndarray:
    """The last changes of sign of the wind that is worst at the end of a flight, shape (FLIPS,)."""
    flips = np.full(FLIPS, np.inf)
    chosen = times[times < duration][:FLIPS]
    flips[: len(chosen)] = duration - chosen
    return flips


class Flown(NamedTuple):
    """How near each signal of each flight came to its bound, as a share of it, shape (count,) each; and the gusts.

    A rotor's thrust counts from that of hover. ``outside_sliding`` is the share of time outside sliding.
    """

    shares: Columns
    outside_sliding: np.ndarray
    columns: Columns

    def left(self) -> np.ndarray:
        """Whether a flight left a bound, or did not slide, shape (count,)."""
        outside = self.outside_sliding > 0.0
        for share in self.shares.values():
            outside |= ~(share <= ROUNDED)
        return outside


def fly(
    problem: JsonObject, bounds: JsonObject, count: int, seconds: float, seed: int, like: JsonObject | None = None
) -> Flown:
    """Fly vehicles of a problem in adversarial winds.

    Args:
        problem: The problem of a certificate.
        bounds: Bounds of the signals: those that :func:`dssc_jax.proofs.vehicle_words.stated_bounds` has, and
            optionally ``speed`` and ``alpha``.
        count: Number of flights.
        seconds: Length of each.
        seed: Of vehicles, starts and winds.
        like: The problem whose resonances the winds use; None: the problem itself.
    """
    rng = np.random.default_rng(seed)
    study = study_of(problem, seconds)
    engine = engine_of(study)
    leaves, _, paths = parameters_of(study)
    columns = {path: np.full(count, leaves[path], float) for path in free(paths)}
    columns |= random_vehicles(problem, count, rng) | random_starts(problem, count, rng)
    times = response_times(json.dumps(like or problem), seconds)
    columns |= random_gusts(study, times, count, rng)
    results = evaluate(engine, columns, rng.integers(0, 2**31, count))
    return Flown(shares_of(problem, bounds, results), outside_of(results), columns)


def shares_of(problem: JsonObject, bounds: JsonObject, results: Columns) -> Columns:
    """Each signal over its bound; infinite if the flight ended early."""
    hover = problem["believed_mass"] * GRAVITY / problem["rotors"]
    shares = {}
    for channel in ("x", "y", "z", "psi"):
        for signal, metric in (("e", "error_max"), ("e_dot", "error_rate_max"), ("sigma", "sigma_max")):
            shares[f"{signal}_{channel}"] = results[f"{metric}_{channel}"] / bounds[channel][signal]
    shares["tilt"] = results["tilt_max"] / bounds["tilt"]
    shares["rotor_max"] = (results["rotor_thrust_max"] - hover) / (bounds["rotor_max"] - hover)
    shares["rotor_min"] = (hover - results["rotor_thrust_min"]) / (hover - bounds["rotor_min"])
    for name in ("speed", "alpha"):
        if name in bounds:
            shares[name] = results[name] / bounds[name]
    ended = results["outcome"] != Outcome.OK
    return {name: np.where(ended, np.inf, share) for name, share in shares.items()}


def outside_of(results: Columns) -> np.ndarray:
    """The largest share of time that a channel spends outside sliding, shape (count,)."""
    return np.max([results[f"outside_sliding_{channel}"] for channel in ("x", "y", "z", "psi")], axis=0)
