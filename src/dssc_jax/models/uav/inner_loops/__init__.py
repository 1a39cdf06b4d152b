"""Inner loops of the vehicle, from commands of velocity and yaw rate to thrust and moment: one file each.

The article's inner loop is continuous in time, so that every stage of the integrator evaluates it. The autopilots'
inner loops are sampled.
"""

from typing import Protocol, TypeVar

from dssc_jax.core.registry import Registry, single
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Vec3
from dssc_jax.models.uav.inner_loops.article import InnerGains
from dssc_jax.models.uav.inner_loops.crazyflie import CrazyflieGains
from dssc_jax.models.uav.inner_loops.px4 import Px4Gains
from dssc_jax.models.uav.inner_loops.sampled import Craft, Readings, Trim
from dssc_jax.models.uav.inner_loops.start import Start
from dssc_jax.models.uav.rotors import Wrench

S = TypeVar("S")


class SampledInnerLoop(Protocol[S]):
    """Gains of a sampled inner loop, with the functions of its software.

    The state of the software has the fields ``unallocated``, the moment [N m] that the rotors did not give at the last
    tick, and ``bounded``, whether the thrust is at its lower limit.
    """

    @property
    def period(self) -> float:
        """Time between two ticks [s]."""
        ...

    def input_gain(self, craft: Craft) -> tuple[Scalar, ...]:
        """k_p of x, y, z and psi: what a command adds to the acceleration at first [1/s]."""
        ...

    @property
    def start(self) -> Start:
        """Whether the integrals start at the study's numbers alone, or at these plus their values in equilibrium."""
        ...

    def init(self, craft: Craft, readings: Readings, carrying: Scalar) -> S:
        """The state in hover; ``carrying`` is the thrust that carries the weight of the draw [N]."""
        ...

    def trimmed(self, craft: Craft, state: S, trim: Trim) -> S:
        """The state with integrals that hold an equilibrium; the study's start values add to them.

        Args:
            craft: The vehicle as the software knows it.
            state: The state in hover, from :meth:`init`.
            trim: The equilibrium.
        """
        ...

    def first_thrust(self, craft: Craft, carrying: Scalar) -> Scalar:
        """The demanded thrust at the start without an error of velocity [N]."""
        ...

    def sample(self, craft: Craft, state: S, readings: Readings, command: Vec3, yaw_command: Scalar, dt: float) -> S:
        """The state after velocity control at a sample of the outer loop, which commands velocity and yaw rate.

        Args:
            craft: The vehicle as the software knows it.
            state: The state before the sample.
            readings: Measurements.
            command: Commanded velocity, inertial [m/s].
            yaw_command: Commanded rate of yaw [rad/s].
            dt: T_s of the loop [s].
        """
        ...

    def tick(self, craft: Craft, state: S, readings: Readings, dt: float) -> tuple[S, Wrench]:
        """The state after attitude and rate control at a tick, and the thrust and moment that they demand.

        Args:
            craft: The vehicle as the software knows it.
            state: The state before the tick.
            readings: Measurements.
            dt: Time since the last tick [s].
        """
        ...


INNER_LOOPS: Registry = {
    "article": single(InnerGains, "the article's: velocity and attitude loops by state feedback, continuous in time"),
    "px4": single(Px4Gains, "PX4's cascade: velocity PID, quaternion attitude control, rate PID; sampled"),
    "crazyflie": single(CrazyflieGains, "the Crazyflie's PID cascade of velocity, angles and rates; sampled"),
}
