"""Fig. 5 as a Monte Carlo: DSSC and STA on the same draws of what the article does not print.

A number of the laws is drawn once and stands in every set-up: kappa1 is the STA's gain and, through kappa_o = 2/(kappa1
tau_av), DSSC's.
"""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import spearmanr

import dssc_jax as dj
from benchmarks.paper.loops import AXES, RHO, TAU_AV, comparison, sta, wide
from benchmarks.paper.signals import SETTLED, SMOOTH, moving_average
from dssc_jax.closed_loop.draw import simulate_recorded
from dssc_jax.core.numerics import stream
from dssc_jax.engine.plain import plain_options
from dssc_jax.engine.sampling import draw_key, inside_cube, uniform
from dssc_jax.statistics import clopper_pearson
from dssc_jax.study.laws import parse_law

DRAWS, SEED, TILE = 256, 1, 64
DURATION, EDGE = 60.0, 5.0  # s: of a flight, and how much of its end the moving averages do not know
SLOW = 10.0  # s: window of the moving average that slow oscillations are taken from
LAWS: dict[str, dict[str, list[float]]] = {
    "kappa1": {"loguniform": [0.2, 1.8]},
    "kappa_m": {"loguniform": [0.002, 8.0]},
    "plant.position.0": {"uniform": [0.0, 40.0]},
    "plant.position.1": {"uniform": [10.0, 30.0]},
    "plant.position.2": {"uniform": [2.0, 10.0]},
    "plant.yaw": {"uniform": [0.0, 1.5]},
    "plant.vehicle.motor_lag": {"loguniform": [0.005, 0.05]},
    "plant.vehicle.mass": {"uniform": [10.8, 11.0]},
    "plant.vehicle.body_inertia.0": {"uniform": [0.37, 0.5]},
    "plant.vehicle.body_inertia.1": {"uniform": [0.37, 0.5]},
    "plant.vehicle.body_inertia.2": {"uniform": [0.64, 0.74]},
}
CLASSES = (0.002, 0.01, 0.05, 0.25, 1.0, 8.0)  # of kappa_m
INNER_LOOPS: dict[str, dict[str, Any]] = {
    "": {},
    "thrust by norm": {"plant.inner_loop.thrust": "norm"},
    "attitude rates fed forward": {"plant.inner_loop.attitude": "rate_feed_forward"},
    "rotors without lag": {"plant.vehicle.motor_lag": None},
}
Columns = dict[str, np.ndarray]


class Flights(NamedTuple):
    """Many flights of one set-up.

    Args:
        lost: Whether a flight ended early, shape (draws,).
        swing: High-frequency rms of the command [m/s, rad/s], shape (draws, channels).
        slow: The same with periods of up to about 10 s, which a moving average over 2 s follows.
    """

    lost: np.ndarray
    swing: np.ndarray
    slow: np.ndarray


def drawn(count: int = DRAWS) -> Columns:
    """Values of every law, one a draw."""
    points = inside_cube(uniform(SEED, tuple(map(stream, LAWS)), np.arange(count)))
    return {name: parse_law(table).quantile(points[:, i]) for i, (name, table) in enumerate(LAWS.items())}


def columns(study: dj.Study, values: Columns) -> Columns:
    """The drawn values under the names that the study's loop has for them.

    Raises:
        KeyError: the loop has no such number.
    """
    found = {name: column for name, column in values.items() if name.startswith("plant.")}
    if study.table["controller"]["kind"] == "sta":
        found["controller.kappa1"] = values["kappa1"]
    else:
        found["controller.functions.kappa_m"] = values["kappa_m"]
        for place, axis in (("", "x"), ("z.", "z"), ("psi.", "psi")):
            found[f"controller.{place}functions.kappa_o"] = 2.0 / (values["kappa1"] * TAU_AV[axis])
    leaves = study.leaves()
    if "plant.vehicle.motor_lag" not in leaves:
        found.pop("plant.vehicle.motor_lag")
    unknown = found.keys() - leaves.keys()
    if unknown:
        raise KeyError(f"the loop has no numbers {sorted(unknown)}")
    return found


def fly(study: dj.Study, values: Columns, count: int = DRAWS) -> Flights:
    """Flights with the named numbers of the study's loop replaced by columns of shape (count,)."""
    tile = min(TILE, count)
    tiles = -(-count // tile)
    padding = tiles * tile - count

    def one(lane: Mapping[str, jax.Array], index: jax.Array):
        run, recorded = simulate_recorded(study.loop, study.params(lane), draw_key(SEED, index))
        pairs = zip(recorded.instant.channels, recorded.references, strict=True)
        back = jnp.stack([sample.u_total - point.y_dot - point.y_ddot for sample, point in pairs])
        return run.outcome, back

    with jax.enable_x64(True):
        shaped = {k: np.pad(v, (0, padding), mode="edge").reshape(tiles, tile) for k, v in values.items()}
        indices = np.arange(tiles * tile, dtype=np.uint32).reshape(tiles, tile)
        flown = jax.jit(
            lambda lanes, index: jax.lax.map(lambda part: jax.vmap(one)(*part), (lanes, index)),
            compiler_options=plain_options(),
        )
        outcome, back = (np.asarray(leaf) for leaf in flown(shaped, indices))
    back = back.reshape(tiles * tile, *back.shape[2:])[:count]
    dt = study.loop.sample_time
    return Flights(outcome.reshape(-1)[:count] != 0, oscillation(back, dt, SMOOTH), oscillation(back, dt, SLOW))


def oscillation(command: np.ndarray, dt: float, period: float) -> np.ndarray:
    """rms of the last axis less its centred moving average over a period [s], from 30 s on."""
    inside = slice(round(SETTLED / dt), command.shape[-1] - round(EDGE / dt))
    gap = command - moving_average(command, dt, period)
    return np.sqrt(np.mean(np.square(gap[..., inside]), axis=-1))


def setups() -> dict[tuple[str, str], dj.Study]:
    """(inner loop, controller) -> study."""
    base = comparison(**{"loop.duration": DURATION, "plant.vehicle.motor_lag": 0.02})
    kept = {"controller.nominal.predictor_term": True}
    found: dict[tuple[str, str], dj.Study] = {}
    for inner, changes in INNER_LOOPS.items():
        study = base.override(changes)
        found[inner, "DSSC"] = study
        if not inner:
            found[inner, "DSSC, 1/tau_m in u_n"] = study.override(kept)
            found[inner, "DSSC, rho = 100, 1/tau_m in u_n"] = wide(study).override(kept)
        found[inner, "DSSC, rho = 100"] = wide(study)
        found[inner, "STA"] = study.override({"controller": sta()})
        found[inner, "STA clipped"] = study.override({"controller": sta(clipped=True)})
        if not inner:
            found[inner, "STA clipped, explicit"] = study.override({"controller": sta(form="explicit", clipped=True)})
    return found


def experiment(count: int = DRAWS) -> tuple[Columns, dict[tuple[str, str], Flights]]:
    """The draws, and the flights of every set-up."""
    values = drawn(count)
    return values, {name: fly(study, columns(study, values), count) for name, study in setups().items()}


def calmer(one: Flights, other: Flights) -> np.ndarray:
    """Draws in which the one flies on and oscillates less than half of what the other does; lost is worst."""
    less = one.swing < 0.5 * other.swing
    return ~one.lost[:, None] & (other.lost[:, None] | less)


def share(flags: np.ndarray) -> str:
    """A share with its Clopper-Pearson interval."""
    low, high = clopper_pearson(int(flags.sum()), flags.size)
    return f"{flags.mean():.2f} [{low:.2f}, {high:.2f}]"


def spread(flights: Flights, channel: int) -> str:
    """Median, and 5 to 95 %, of the oscillation of the flights that were not lost."""
    values = flights.swing[~flights.lost, channel]
    if not len(values):
        return "-"
    low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
    return f"{middle:.2g} [{low:.1g}, {high:.1g}]"


def setup_rows(flights: dict[tuple[str, str], Flights]) -> list[tuple[str, ...]]:
    """A row for each set-up; DSSC is paired with the clipped STA in the same inner loop."""
    rows = []
    for (inner, controller), flown in flights.items():
        paired = ""
        if controller.startswith("DSSC"):
            better = calmer(flown, flights[inner, "STA clipped"])
            paired = ", ".join(f"{value:.2f}" for value in better.mean(axis=0))
        name = f"{controller}; {inner}" if inner else controller
        rows.append((name, share(flown.lost), *(spread(flown, i) for i in range(len(AXES))), paired))
    return rows


def class_rows(values: Columns, flights: dict[tuple[str, str], Flights]) -> list[tuple[str, ...]]:
    """What DSSC does, alone and against the clipped STA, by class of kappa_m."""
    one, other = flights["", "DSSC"], flights["", "STA clipped"]
    better, rho = calmer(one, other), list(RHO.values())
    rows = []
    for low, high in pairwise(CLASSES):
        inside = (values["kappa_m"] >= low) & (values["kappa_m"] < high)
        flown = inside & ~one.lost
        medians = [np.median(size[flown], axis=0) / rho for size in (one.swing, one.slow)]
        lost = [flights["", name].lost[inside] for name in ("DSSC, rho = 100", "DSSC, 1/tau_m in u_n")]
        rows.append(
            (
                f"{low:g} to {high:g}",
                f"{inside.sum()}",
                *(", ".join(f"{value:.2g}" for value in numbers) for numbers in medians),
                *(share(better[inside, i]) for i in range(len(AXES))),
                *(share(flags) for flags in lost),
            )
        )
    return rows


def ranks(values: Columns, one: Flights, other: Flights, channel: int = 0) -> dict[str, float]:
    """Spearman's correlation of every drawn number with DSSC's oscillation over the clipped STA's."""
    flown = ~one.lost & ~other.lost
    ratio = one.swing[flown, channel] / other.swing[flown, channel]
    return {name: float(spearmanr(column[flown], ratio).statistic) for name, column in values.items()}
