"""The two loops that everything is measured on, and their numbers as programs without JAX take them."""

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

import dssc_jax as dj
from dssc_jax.core.integrators import Integrator
from dssc_jax.engine.batching import medians, values_of_draws
from dssc_jax.models.references.sine import MISSION, Axis, SineParams

HERE = Path(__file__).parent
METRICS = ("error_rms", "error_max", "command_tv")
DRAWN = {
    "uav": (
        "plant.vehicle.mass",
        *(f"plant.vehicle.body_inertia.{i}" for i in range(3)),
        "plant.vehicle.thrust_coefficient",
    ),
    "axis": ("plant.k_p", "plant.a_p", "unmodelled.mu", "disturbance.value"),
}
"""Uncertain numbers of each loop, in the order in which the other programs take them."""
EVENT = {"uav": "wind.at", "axis": "disturbance.at"}
"""What happens after a quarter of the duration."""


class Case(NamedTuple):
    """One thing to time.

    Args:
        loop: ``uav`` or ``axis``.
        integrator: Between two samples, one substep. It does not matter to the axis, which is linear and held exactly.
        precision: Bits of a number, 64 or 32.
    """

    loop: str
    integrator: str = Integrator.RK4.value
    precision: int = 64

    @property
    def text(self) -> str:
        """As a table names it."""
        if self.loop == "axis":
            return f"1-DOF, exact, float{self.precision}"
        method = {"rk4": "RK4", "euler": "Euler"}[self.integrator]
        return f"UAV, {method}, float{self.precision}"


CASES = [Case("uav", method, bits) for method in ("rk4", "euler") for bits in (64, 32)]
CASES += [Case("axis", precision=bits) for bits in (64, 32)]


def study_of(case: Case, draws: int, duration: float) -> dj.Study:
    """The case's study for so many draws of so many seconds."""
    changes = {
        "draws": draws,
        "loop.duration": duration,
        "loop.integrator": case.integrator,
        "loop.precision": case.precision,
        EVENT[case.loop]: duration / 4.0,
    }
    return dj.Study.load(HERE / f"{case.loop}.toml").override(changes)


class Gains(NamedTuple):
    """A DSSC channel with the square-root functions and nominal control."""

    l0: float
    rho: float
    kappa_o: float
    kappa_m: float
    delta_o: float
    delta_m: float
    tau_av: float
    a_n: float
    k_n: float


class Sine(NamedTuple):
    """offset + amplitude sin(rate t + phase)."""

    amplitude: float
    rate: float
    phase: float
    offset: float


class Uav(NamedTuple):
    """Numbers of the full UAV that all draws share; ``allocation`` has a row (f, M_x, M_y, M_z) for each rotor."""

    channel: tuple[Gains, ...]
    wanted: tuple[Sine, ...]
    wind: tuple[float, ...]
    wind_from: float
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    yaw: float
    kp_velocity: float
    kd_velocity: float
    kp_attitude: float
    kd_attitude: float
    kp_yaw: float
    kd_yaw: float
    believed_mass: float
    believed_inertia: tuple[float, ...]
    believed_thrust_coefficient: float
    allocation: tuple[tuple[float, ...], ...]
    rotor_x: tuple[float, ...]
    rotor_y: tuple[float, ...]
    spin: tuple[float, ...]
    torque_coefficient: float
    rotor_inertia_xy: float
    rotor_inertia_z: float
    structure_drag: tuple[float, ...]
    propeller_drag: float


class OneAxis(NamedTuple):
    """Numbers of the one-degree-of-freedom loop that all draws share."""

    channel: Gains
    wanted: tuple[Sine]
    position: float
    velocity: float
    disturbed_from: float
    matched: float


def gains_of(controller) -> Gains:
    """The numbers of one channel's controller."""
    functions, nominal = controller.functions, controller.nominal
    return Gains(controller.l0, controller.rho.rho, *functions, nominal.a, nominal.k)


def sine_of(params: SineParams) -> Sine:
    """The reference as a sine."""
    return Sine(params.amplitude, 2.0 * np.pi / params.period, params.phase, params.offset)


def numbers(study: dj.Study) -> Uav | OneAxis:
    """A benchmark study's numbers that all draws share."""
    params = study.params(medians(study))
    plant, channels = params.plant, tuple(map(gains_of, params.controller))
    if not study.loop.plant.channels:
        matched = float(params.controller[0].predictor_start == "matched")
        return OneAxis(channels[0], (sine_of(MISSION[Axis.X]),), *plant.initial, params.disturbance[0].at, matched)
    vehicle, inner, believed = plant.vehicle, plant.inner_loop, plant.believed
    x, y = (tuple(vehicle.arm * along for along in axis) for axis in vehicle.directions())
    return Uav(
        channel=channels,
        wanted=tuple(map(sine_of, MISSION.values())),
        wind=(params.wind.x, params.wind.y, params.wind.z),
        wind_from=params.wind.at,
        position=plant.position,
        velocity=plant.velocity,
        yaw=plant.yaw,
        **{name: getattr(inner, name) for name in Uav._fields if hasattr(inner, name)},
        believed_mass=believed.mass,
        believed_inertia=believed.inertia,
        believed_thrust_coefficient=believed.thrust_coefficient,
        allocation=plant.allocation,
        rotor_x=x,
        rotor_y=y,
        spin=vehicle.spins,
        torque_coefficient=vehicle.torque_coefficient,
        rotor_inertia_xy=vehicle.rotor_inertia_xy,
        rotor_inertia_z=vehicle.rotor_inertia_z,
        structure_drag=vehicle.structure_drag,
        propeller_drag=vehicle.propeller_drag,
    )


class Task(NamedTuple):
    """A case with its draws, ready for any program.

    Args:
        case: What is timed.
        study: Its study.
        draws: Uncertain numbers, shape (numbers, draws), float64.
        shared: Numbers that all draws share.
    """

    case: Case
    study: dj.Study
    draws: np.ndarray
    shared: Uav | OneAxis

    @property
    def steps(self) -> int:
        """Lane-steps: draws times samples."""
        return self.draws.shape[1] * self.study.loop.steps

    def drawn(self, names: Iterable[str]) -> list[np.ndarray]:
        """The uncertain numbers of these names."""
        rows = dict(zip(DRAWN[self.case.loop], self.draws, strict=True))
        return [rows[name] for name in names]


def task(case: Case, draws: int, duration: float) -> Task:
    """A case with so many draws of so many seconds."""
    study = study_of(case, draws, duration)
    values = values_of_draws(study, slice(0, draws))
    return Task(case, study, np.stack([values[name] for name in DRAWN[case.loop]]), numbers(study))


class Found(NamedTuple):
    """What every program finds.

    Args:
        metrics: error_rms, error_max, command_tv of each channel; NaN where a draw ended early, (3, channels, draws).
        outcome: 0 finished, 1 not finite, 2 singular attitude, (draws,).
        samples: Samples until a draw ended, (draws,).
    """

    metrics: np.ndarray
    outcome: np.ndarray
    samples: np.ndarray


def disagreement(ours: Found, other: Found) -> float:
    """Largest relative difference of a metric over all draws; infinite where a draw's outcome differs."""
    if not np.array_equal(ours.outcome, other.outcome) or not np.array_equal(ours.samples, other.samples):
        return np.inf
    alive = ours.outcome == 0
    a, b = ours.metrics[..., alive], other.metrics[..., alive]
    return float(np.max(np.abs(a - b) / np.abs(a)))


ALLOWED = {64: 1e-9, 32: 2e-3}
"""Largest relative difference of a metric between two programs, by precision: 16,000 samples of rounding."""


def agree(case: Case, one: Found, other: Found) -> bool:
    """Whether two programs found the same."""
    return disagreement(one, other) <= ALLOWED[case.precision]
