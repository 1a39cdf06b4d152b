"""Certificates with one thing changed: the verifier rejects them, or what they then say is true."""

import copy
import multiprocessing
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from benchmarks.vehicle_proofs.designs import PROCESSES, Design, bounds_of
from dssc_jax.core.json_types import JsonObject
from dssc_jax.proofs.verifier.vehicle.verdict import verify_vehicle

FACTORS = (0.95, 0.99, 1.01, 1.05)
CHANNELS = ("x", "z", "psi")
INNER = ("velocity_gain", "stiffness", "damping", "yaw_gain", "yaw_integral_gain")
ROTORS = ("arm", "torque_coefficient", "thrust_coefficient", "rotor_limit", "rotor_inertia")
Change = Callable[[JsonObject, float, np.random.Generator], None]


class Falsified(NamedTuple):
    """A changed certificate and its verdict.

    Args:
        kind: What was changed.
        content: The changed certificate.
        origin: The problem before the change.
        bounds: Bounds that the verifier accepted; None: it rejected them.
        reason: Why it rejected them.
    """

    kind: str
    content: JsonObject
    origin: JsonObject
    bounds: JsonObject | None
    reason: str


def proof_of(content: JsonObject, rng: np.random.Generator) -> JsonObject:
    """The proof of a random channel."""
    return content["proof"]["channels"][str(rng.choice(CHANNELS))]


def controller_of(content: JsonObject, rng: np.random.Generator) -> JsonObject:
    """The controller of a random channel."""
    return content["problem"]["channels"][str(rng.choice(CHANNELS))]


def scaled(table: Any, key: Any, factor: float) -> None:
    """Scale an entry."""
    table[key] = factor * table[key]


def one_entry(names: Sequence[str]) -> Change:
    """Scale one of several entries of the problem."""
    return lambda content, factor, rng: scaled(content["problem"], str(rng.choice(names)), factor)


def moved_end(interval: list[float], factor: float) -> list[float]:
    """An interval of which one end has moved outwards."""
    low, high = interval
    return [factor * low, high] if factor < 1.0 else [low, factor * high]


def change_interval(name: str) -> Change:
    """Widen an interval of the problem."""

    def change(content: JsonObject, factor: float, rng: np.random.Generator) -> None:
        content["problem"][name] = moved_end(content["problem"][name], factor)

    return change


def change_inertia(content: JsonObject, factor: float, rng: np.random.Generator) -> None:
    """Widen the interval of one inertia."""
    place = int(rng.integers(3))
    content["problem"]["inertia"][place] = moved_end(content["problem"]["inertia"][place], factor)


def change_wind(content: JsonObject, factor: float, rng: np.random.Generator) -> None:
    """Scale a bound of the wind."""
    scaled(content["problem"]["wind"], int(rng.integers(2)), factor)


def change_drag(content: JsonObject, factor: float, rng: np.random.Generator) -> None:
    """Scale a coefficient of the drag."""
    if rng.random() < 0.3:
        scaled(content["problem"], "propeller_drag", factor)
    else:
        scaled(content["problem"]["structure_drag"], int(rng.integers(2)), factor)


def change_functions(content: JsonObject, factor: float, rng: np.random.Generator) -> None:
    """Scale a constant of the state-dependent functions."""
    functions = controller_of(content, rng)["functions"]
    scaled(functions, str(rng.choice([name for name in functions if name != "kind"])), factor)


def change_l0(content: JsonObject, factor: float, rng: np.random.Generator) -> None:
    """Scale an error pole."""
    scaled(controller_of(content, rng), "l0", factor)


def change_rho(content: JsonObject, factor: float, rng: np.random.Generator) -> None:
    """Scale a bound of the switched control; a third of them far down."""
    scaled(controller_of(content, rng), "rho", 0.1 if rng.random() < 1.0 / 3.0 else factor)


def change_start(content: JsonObject, factor: float, rng: np.random.Generator) -> None:
    """A start that is further away."""
    place = int(rng.integers(2))
    channel = controller_of(content, rng)
    channel["initial"][place] = channel["initial"][place] * factor + 0.01


def change_lag(content: JsonObject, factor: float, rng: np.random.Generator) -> None:
    """Scale the rotors' lag; one of 1 ms where there is none."""
    lag = content["problem"]["rotor_lag"]
    content["problem"]["rotor_lag"] = factor * lag if lag else 1e-3


def change_delay(content: JsonObject, factor: float, rng: np.random.Generator) -> None:
    """Scale the delay; a delay of 1 % of a sample where there is none."""
    delay = content["problem"]["delay"]
    content["problem"]["delay"] = factor * delay if delay else 0.01


def change_slopes(content: JsonObject, factor: float, rng: np.random.Generator) -> None:
    """Scale a slope."""
    scaled(proof_of(content, rng)["slopes"], int(rng.integers(3)), factor)


def change_damping(content: JsonObject, factor: float, rng: np.random.Generator) -> None:
    """Scale the damping of x or z."""
    scaled(content["proof"]["channels"][str(rng.choice(["x", "z"]))], "drag_damping", factor)


def change_rate(content: JsonObject, factor: float, rng: np.random.Generator) -> None:
    """Scale lambda; a third of them to ten times as much."""
    scaled(proof_of(content, rng), "rate", 10.0 if rng.random() < 1.0 / 3.0 else factor)


def change_p(content: JsonObject, factor: float, rng: np.random.Generator) -> None:
    """Entries of P by 1 % or 5 %; a third of them with the other sign."""
    proof = proof_of(content, rng)
    p = np.array(proof["p"])
    noise = abs(factor - 1.0) * rng.standard_normal(p.shape)
    changed = -p if rng.random() < 1.0 / 3.0 else p * (1.0 + noise + noise.T)
    proof["p"] = (0.5 * (changed + changed.T)).tolist()


def change_bound(content: JsonObject, factor: float, rng: np.random.Generator) -> None:
    """Scale the bound of a signal."""
    bounds = proof_of(content, rng)["bounds"]
    scaled(bounds, str(rng.choice(list(bounds))), factor)


def lower_bound(content: JsonObject, factor: float, rng: np.random.Generator) -> None:
    """Turn a bound down to between a fifth and nine tenths."""
    bounds = proof_of(content, rng)["bounds"]
    scaled(bounds, str(rng.choice(list(bounds))), float(rng.uniform(0.2, 0.9)))


def exchange_signals(content: JsonObject, factor: float, rng: np.random.Generator) -> None:
    """Exchange the bounds of two signals of a channel."""
    bounds = proof_of(content, rng)["bounds"]
    one, other = map(str, rng.choice(list(bounds), 2, replace=False))
    bounds[one], bounds[other] = bounds[other], bounds[one]


def exchange_rows(content: JsonObject, factor: float, rng: np.random.Generator) -> None:
    """Exchange the bounds that two channels have in common, or the channels' proofs."""
    proofs = content["proof"]["channels"]
    one, other = map(str, rng.choice(CHANNELS, 2, replace=False))
    if rng.random() < 0.3:
        proofs[one], proofs[other] = proofs[other], proofs[one]
        return
    first, second = proofs[one]["bounds"], proofs[other]["bounds"]
    for signal in first.keys() & second.keys():
        first[signal], second[signal] = second[signal], first[signal]


def change_cell(content: JsonObject, factor: float, rng: np.random.Generator) -> None:
    """Scale the bound of a signal in one cell of time; a third of them far down."""
    signals = content["proof"]["cells"]["bounds"][str(rng.choice(CHANNELS))]
    bounds = signals[str(rng.choice(list(signals)))]
    scaled(bounds, int(rng.integers(len(bounds))), 0.5 if rng.random() < 1.0 / 3.0 else factor)


def change_settled(content: JsonObject, factor: float, rng: np.random.Generator) -> None:
    """Scale a slope of the linear channels for the upper limits, or the rate of one; a third of them far up."""
    middle = content["proof"]["settled"][str(rng.choice(CHANNELS))]
    factor = 10.0 if rng.random() < 1.0 / 3.0 else factor
    if rng.random() < 0.5:
        scaled(middle["slopes"], int(rng.integers(2)), factor)
    else:
        scaled(middle, "rate", factor)


CHANGES: dict[str, Change] = {
    "wind": change_wind,
    "mass": change_interval("mass"),
    "thrust": change_interval("thrust"),
    "turn": change_interval("turn"),
    "inertia": change_inertia,
    "inner gains": one_entry(INNER),
    "rotors": one_entry(ROTORS),
    "drag": change_drag,
    "functions": change_functions,
    "l0": change_l0,
    "rho": change_rho,
    "T_s": one_entry(["sample_time"]),
    "delay": change_delay,
    "rotor lag": change_lag,
    "start": change_start,
    "slopes": change_slopes,
    "drag damping": change_damping,
    "rate": change_rate,
    "P": change_p,
    "a bound": change_bound,
    "a bound turned down": lower_bound,
    "signals exchanged": exchange_signals,
    "channels exchanged": exchange_rows,
    "a cell's bound": change_cell,
    "channels of the upper limits": change_settled,
}
"""What is changed, by kind."""
IN_CELLS = ("a cell's bound", "channels of the upper limits")
"""Kinds that only a certificate with cells of time has."""


def falsify(certificate: JsonObject, kind: str, rng: np.random.Generator) -> JsonObject:
    """A certificate with one thing changed."""
    content = copy.deepcopy(certificate)
    CHANGES[kind](content, float(rng.choice(FACTORS)), rng)
    return content


def verified(task: tuple[str, JsonObject, JsonObject]) -> Falsified:
    """A changed certificate with its verdict."""
    kind, content, origin = task
    verdict = verify_vehicle(content)
    return Falsified(kind, content, origin, bounds_of(verdict) if verdict.proved else None, verdict.reason)


def falsified(designs: Sequence[Design], count: int, seed: int) -> list[Falsified]:
    """So many changed certificates with their verdicts; every kind in turn."""
    rng = np.random.default_rng(seed)
    kinds = list(CHANGES)
    with_cells = [design for design in designs if design.certificate["proof"]["cells"] is not None]
    tasks = []
    for place in range(count):
        kind = kinds[place % len(kinds)]
        candidates = with_cells if kind in IN_CELLS else designs
        design = candidates[int(rng.integers(len(candidates)))]
        certificate = plain(design.certificate)
        tasks.append((kind, falsify(certificate, kind, rng), certificate["problem"]))
    with multiprocessing.get_context("spawn").Pool(PROCESSES) as pool:
        return pool.map(verified, tasks, chunksize=1)


def plain(value: Any) -> Any:
    """JSON's types, with lists in place of tuples."""
    if isinstance(value, dict):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    return value
