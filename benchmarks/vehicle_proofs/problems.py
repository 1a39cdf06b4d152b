"""From the problem of a certificate back to a study, and to vehicles within its intervals.

The way back is a check of its own: :func:`dssc_jax.proofs.vehicle_coverage.vehicle_problem_of` of the study gives the
problem again.
"""

import math
from typing import Any

import numpy as np

import dssc_jax as dj
from dssc_jax.core.json_types import JsonObject
from dssc_jax.core.vectors import Vec3
from dssc_jax.models.references.sine import MISSION
from dssc_jax.models.uav.vehicle import QUADROTOR, alternating, ring

MEMORY = 8.0
"""Longest delay that a flight can have [samples]."""
NUMBERS = ("mass", "thrust", "J_x", "J_y", "J_z")
TRIES = 100
Columns = dict[str, np.ndarray]


def study_of(problem: JsonObject, duration: float, substeps: int = 1) -> dj.Study:
    """The study that flies a vehicle's problem, at the middle of its intervals and from where its reference begins."""
    delay = {"kind": "delay", "samples": problem["delay"], "memory": MEMORY}
    table = {
        "name": "vehicle-flights",
        "draws": 1,
        "loop": {"duration": duration, "sample_time": problem["sample_time"], "substeps": substeps},
        "plant": plant_table(problem),
        "reference": {"kind": "hover" if problem["reference"] is None else "mission"},
        "controller": controller_table(problem),
        "unmodelled": delay if problem["delay"] > 0.0 else {"kind": "none"},
        "wind": {"kind": "bounded", "speed": problem["wind"][0], "vertical": problem["wind"][1]},
        "metrics": {"names": ["error_max", "error_rate_max", "sigma_max", "outside_sliding", "tilt_max"]},
    }
    table["metrics"]["names"] += ["rotor_thrust_max", "rotor_thrust_min"]
    return dj.Study.from_table(table)


def plant_table(problem: JsonObject) -> dict[str, Any]:
    """The table ``[plant]``: the vehicle at the middle of its intervals, and its inner loops."""
    middle = {name: np.array([0.5 * sum(interval)]) for name, interval in intervals_of(problem).items()}
    chosen = vehicle_numbers(problem, middle)
    rotors = problem["rotors"]
    side, up = problem["structure_drag"]
    vehicle = {
        "kind": "m600_quadrotor",
        "mass": float(chosen["plant.vehicle.mass"][0]),
        "body_inertia": [float(chosen[f"plant.vehicle.body_inertia.{i}"][0]) for i in range(3)],
        "rotor_inertia_z": problem["rotor_inertia"],
        "thrust_coefficient": float(chosen["plant.vehicle.thrust_coefficient"][0]),
        "torque_coefficient": problem["torque_coefficient"],
        "arm": problem["arm"],
        "structure_drag": [side, side, up],
        "propeller_drag": problem["propeller_drag"],
        "rotor_angles": list(ring(rotors)),
        "spins": list(alternating(rotors)),
        "max_thrust": problem["rotor_limit"],
    }
    if problem["rotor_lag"]:
        vehicle["motor_lag"] = problem["rotor_lag"]
    believed = {"mass": problem["believed_mass"], "inertia": list(problem["believed_inertia"])}
    inner = {
        "kd_velocity": problem["velocity_gain"],
        "kp_attitude": problem["stiffness"],
        "kd_attitude": problem["damping"],
        "kd_yaw": problem["yaw_gain"],
        "kp_yaw": problem["yaw_integral_gain"],
        "thrust": "projection",
        "attitude": "plain",
    }
    believed["thrust_coefficient"] = problem["thrust_coefficient"]
    plant = {"kind": "uav", "vehicle": vehicle, "believed": believed, "inner_loop": inner}
    places, speeds, yaw = first_points(problem)
    return plant | {"position": places, "velocity": speeds, "yaw": yaw}


def first_points(problem: JsonObject) -> tuple[list[float], list[float], float]:
    """Position, velocity and yaw with which the reference begins."""
    if problem["reference"] is None:
        return [0.0] * 3, [0.0] * 3, 0.0
    points = {}
    for axis, sine in MISSION.items():
        swing = sine.amplitude * complex(math.cos(sine.phase), math.sin(sine.phase))
        points[str(axis)] = sine.offset + swing.imag, 2.0 * math.pi / sine.period * swing.real
    moving = [points[axis] for axis in ("x", "y", "z")]
    return [place for place, _ in moving], [speed for _, speed in moving], points["psi"][0]


def controller_table(problem: JsonObject) -> dict[str, Any]:
    """The table ``[controller]``, with tables of their own for z and psi."""
    tables = {name: channel_table(channel) for name, channel in problem["channels"].items()}
    shared = {"kind": "dssc", "discretisation": "conservative", **tables["x"]}
    return {**shared, "z": tables["z"], "psi": tables["psi"]}


def channel_table(channel: JsonObject) -> dict[str, Any]:
    """The controller of one channel."""
    table = {
        "l0": channel["l0"],
        "rho": channel["rho"],
        "functions": dict(channel["functions"]),
        "predictor_start": channel["start"],
    }
    if channel["nominal"] is not None:
        a, k, term = channel["nominal"]
        table["nominal"] = {"a": a, "k": k, "predictor_term": term}
    return table


def intervals_of(problem: JsonObject) -> dict[str, tuple[float, float]]:
    """The intervals of the mass, of kappa and of the inertias."""
    return dict(zip(NUMBERS, [problem["mass"], problem["thrust"], *problem["inertia"]], strict=True))


def vehicle_numbers(problem: JsonObject, chosen: Columns) -> Columns:
    """Numbers of the plant, by their place, of vehicles with the given masses, kappas and inertias."""
    ratio = chosen["thrust"] * chosen["mass"] / problem["believed_mass"]
    bare = Vec3(*(problem["rotors"] * np.array([QUADROTOR.rotor_inertia_xy] * 2 + [problem["rotor_inertia"]])))
    columns = {
        "plant.vehicle.mass": chosen["mass"],
        "plant.vehicle.thrust_coefficient": ratio * problem["thrust_coefficient"],
    }
    for place, (axis, rotors) in enumerate(zip("xyz", bare, strict=True)):
        columns[f"plant.vehicle.body_inertia.{place}"] = chosen[f"J_{axis}"] - rotors
    return columns


def random_vehicles(problem: JsonObject, count: int, rng: np.random.Generator) -> Columns:
    """Vehicles within a problem's intervals, every nu_i within its own; half of the numbers are at an end of theirs."""
    intervals = intervals_of(problem)
    chosen = {name: np.full(count, np.nan) for name in intervals}
    open_places = np.arange(count)
    for _ in range(TRIES):
        drawn = {name: at_ends_or_within(interval, len(open_places), rng) for name, interval in intervals.items()}
        ratio = drawn["thrust"] * drawn["mass"] / problem["believed_mass"]
        admitted = np.ones(len(open_places), bool)
        for axis, believed in zip("xyz", problem["believed_inertia"], strict=True):
            turn = ratio * believed / drawn[f"J_{axis}"]
            admitted &= (turn >= problem["turn"][0] * (1.0 - 1e-12)) & (turn <= problem["turn"][1] * (1.0 + 1e-12))
        for name, column in drawn.items():
            chosen[name][open_places[admitted]] = column[admitted]
        open_places = open_places[~admitted]
        if not len(open_places):
            return vehicle_numbers(problem, chosen)
    raise ValueError("hardly a vehicle satisfies the intervals of the problem")


def at_ends_or_within(interval: tuple[float, float], count: int, rng: np.random.Generator) -> np.ndarray:
    """Numbers of an interval: one half is at its ends."""
    low, high = interval
    return np.where(rng.random(count) < 0.5, rng.choice([low, high], count), rng.uniform(low, high, count))


def random_starts(problem: JsonObject, count: int, rng: np.random.Generator) -> Columns:
    """Where the flights begin: within the problem's bounds, one half as far away as they allow."""
    channels = problem["channels"]
    places, speeds, yaw = first_points(problem)
    columns = {"plant.yaw": yaw + signs(rng, count) * sizes(rng, count, channels["psi"]["initial"][0])}
    for place, (name, origin) in enumerate((("position", places), ("velocity", speeds))):
        angle = rng.uniform(0.0, 2.0 * np.pi, count)
        length = sizes(rng, count, channels["x"]["initial"][place])
        columns[f"plant.{name}.0"] = origin[0] + length * np.cos(angle)
        columns[f"plant.{name}.1"] = origin[1] + length * np.sin(angle)
        columns[f"plant.{name}.2"] = origin[2] + signs(rng, count) * sizes(rng, count, channels["z"]["initial"][place])
    return columns


def sizes(rng: np.random.Generator, count: int, bound: float) -> np.ndarray:
    """Sizes up to a bound, one half of them at it."""
    return bound * np.where(rng.random(count) < 0.5, 1.0, rng.random(count))


def signs(rng: np.random.Generator, count: int) -> np.ndarray:
    """Random signs."""
    return rng.choice([-1.0, 1.0], count)
