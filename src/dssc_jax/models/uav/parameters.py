"""Parameters of the complete UAV, and the numbers that follow from their nominal values before tracing."""

from collections.abc import Sequence
from typing import Annotated, NamedTuple

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import root_abs
from dssc_jax.core.quantities import Quantity, extent, nominal
from dssc_jax.core.registry import Slot
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Vec3
from dssc_jax.models.uav.allocation import flying_allocation, geometry
from dssc_jax.models.uav.battery import Battery, checked_battery, rotor_power
from dssc_jax.models.uav.desaturation import Desaturation
from dssc_jax.models.uav.estimators import ESTIMATORS, Estimator, NoEstimator
from dssc_jax.models.uav.ground import Ground, lift_factor, prepared_ground
from dssc_jax.models.uav.inner_loops import INNER_LOOPS, SampledInnerLoop
from dssc_jax.models.uav.inner_loops.article import InnerGains
from dssc_jax.models.uav.inner_loops.sampled import Craft
from dssc_jax.models.uav.inner_loops.start import Start
from dssc_jax.models.uav.presets import VEHICLES
from dssc_jax.models.uav.rotors import wrench
from dssc_jax.models.uav.vehicle import GRAVITY, Rotor, Vehicle

EQUAL_SHARE = 1e-9
"""A smaller difference between a rotor's share of the weight in hover and that of equal rotors is rounding."""


class Believed(NamedTuple):
    """What the inner loop believes of the vehicle.

    A number that is None becomes the vehicle's own, with the median in place of a law.
    """

    mass: Annotated[Scalar | None, Quantity("kg", "believed mass M_n", above=0.0)] = None
    inertia: Annotated[tuple[Scalar, ...] | None, Quantity("kg m^2", "believed total inertia J", above=0.0)] = None
    thrust_coefficient: Annotated[Scalar | None, Quantity("N s^2/rad^2", "believed k_T", above=0.0)] = None


class InnerModel(NamedTuple):
    """The vehicle as the inner loop believes it: mass M [kg], diagonal of its inertia J [kg m^2], k_T [N s^2/rad^2]."""

    mass: Scalar
    inertia: Vec3
    thrust_coefficient: Scalar


class UavParams(NamedTuple):
    """Parameters of the UAV: the vehicle, its software, and its state at the start.

    The attitude at the start is R_z(yaw) R_y(pitch) R_x(roll). Absent roll and pitch are 0, or as in the equilibrium
    in the wind if the integrals start settled.

    The fields after ``battery`` follow from the vehicle's nominal values before tracing:

    * ``allocation``: rows from net thrust and moments (f, M) to the thrust f_i of each rotor;
    * ``moments``: rows from the thrusts f_i to the moments M_x, M_y, M_z;
    * ``hover_shares``: each rotor's share of the weight in hover; () for equal shares of rotors on a circle;
    * ``believed_rotors``: the k_T that the inner loop believes of each rotor with a given place; () for rotors on a
      circle, which share the one of ``believed``;
    * ``rotor_limit``: a rotor's largest thrust as the inner loop knows it [N].
    """

    vehicle: Annotated[Vehicle, Slot(VEHICLES, default="m600_quadrotor")]
    believed: Believed = Believed()
    inner_loop: Annotated[InnerGains | SampledInnerLoop, Slot(INNER_LOOPS, default="article")] = InnerGains()
    position: Annotated[tuple[Scalar, ...], Quantity("m", "initial position")] = (0.0, 0.0, 0.0)
    velocity: Annotated[tuple[Scalar, ...], Quantity("m/s", "initial velocity")] = (0.0, 0.0, 0.0)
    yaw: Annotated[Scalar, Quantity("rad", "initial yaw psi")] = 0.0
    roll: Annotated[Scalar | None, Quantity("rad", "initial roll phi")] = None
    pitch: Annotated[Scalar | None, Quantity("rad", "initial pitch theta")] = None
    body_rate: Annotated[tuple[Scalar, ...], Quantity("rad/s", "initial body rate, about body x, y, z")] = (
        0.0,
        0.0,
        0.0,
    )
    estimator: Annotated[NoEstimator | Estimator, Slot(ESTIMATORS, default="none")] = NoEstimator()
    desaturation: Desaturation = Desaturation.CLIP
    ground: Ground | None = None
    battery: Battery | None = None
    allocation: tuple = ()
    moments: tuple = ()
    hover_shares: tuple = ()
    believed_rotors: tuple = ()
    rotor_limit: float = 0.0

    @property
    def inner_model(self) -> InnerModel:
        """The mass, inertia and thrust coefficient that the inner loop assumes; to be read after :func:`prepare`."""
        mass, inertia, thrust_coefficient = self.believed
        assert mass is not None
        assert inertia is not None
        assert thrust_coefficient is not None
        return InnerModel(mass, Vec3(*inertia), thrust_coefficient)

    @property
    def believed_coefficients(self) -> tuple[Scalar, ...]:
        """The k_T of each rotor that the inner loop assumes [N s^2/rad^2]; all are equal before :func:`prepare`."""
        return self.believed_rotors or (self.inner_model.thrust_coefficient,) * self.vehicle.rotors

    @property
    def hover_thrusts(self) -> tuple[Scalar, ...]:
        """Thrust of each rotor in hover [N], with the mass that the inner loop assumes."""
        return self.shared_in_hover(self.inner_model.mass * GRAVITY)

    def shared_in_hover(self, lift: Scalar) -> tuple[Scalar, ...]:
        """Thrust of each rotor [N] when all rotors together give a lift, which they share as in hover.

        Before :func:`prepare` the shares are equal.

        Args:
            lift: Force of all rotors along body z [N].
        """
        if not self.hover_shares:
            return (lift / self.vehicle.rotors,) * self.vehicle.rotors
        return tuple(share * lift for share in self.hover_shares)

    def power_at_full_voltage(self, speeds: Sequence[Scalar]) -> Scalar:
        """Electrical power P of the rotors at the battery's full voltage [W], for a vehicle with a battery.

        It is the mechanical power over the efficiency. If the hover power is given instead, it is the hover power times
        the mechanical power over that in hover with the believed mass and thrust coefficients.

        Args:
            speeds: Speed of each rotor at full voltage [rad/s].
        """
        battery = self.battery
        assert battery is not None
        torques = self.vehicle.torque_coefficients
        power = rotor_power(torques, self.vehicle.thrust_coefficients, speeds)
        if battery.efficiency is not None:
            return power / battery.efficiency
        assert battery.hover_power is not None
        coefficients = self.believed_coefficients
        hover_speeds = []
        for thrust, coefficient in zip(self.hover_thrusts, coefficients, strict=True):
            hover_speeds.append(root_abs(thrust / coefficient))
        return power * (battery.hover_power / rotor_power(torques, coefficients, hover_speeds))

    @property
    def carrying_thrust(self) -> Scalar:
        """The net thrust that the inner loop must want for the draw to hover at its place [N]; see :func:`prepare`.

        It differs from the believed weight by the draw's mass, its thrust coefficients and the effect of the ground.
        Rotors that are commanded to carry the believed weight give another lift; the believed weight is multiplied by
        the draw's weight over this lift.
        """
        rotors = zip(self.hover_thrusts, self.vehicle.thrust_coefficients, self.believed_coefficients, strict=True)
        thrusts = tuple(f * actual / believed for f, actual, believed in rotors)
        lift = wrench(self.vehicle, thrusts).thrust
        if self.ground is not None and self.ground.rotor_radius is not None:
            _, _, height = self.position
            lift = lift * lift_factor(self.ground, height)
        return self.inner_model.mass * GRAVITY * (self.vehicle.mass * GRAVITY / lift)

    @property
    def first_thrust(self) -> Scalar:
        """The net thrust that the inner loop wants at the start, complete after :func:`prepare` [N]."""
        return self.inner_loop.first_thrust(self.craft, self.first_carrying)

    @property
    def first_carrying(self) -> Scalar:
        """The thrust [N] that carries the draw's weight if the integrals start settled, else the believed weight."""
        is_settled = self.inner_loop.start is Start.SETTLED
        return self.carrying_thrust if is_settled else self.inner_model.mass * GRAVITY

    @property
    def first_thrusts(self) -> tuple[Scalar, ...]:
        """Commanded thrusts of the rotors at the start, complete after :func:`prepare` [N]."""
        return self.shared_in_hover(self.first_thrust)

    @property
    def craft(self) -> Craft:
        """The vehicle as the inner loop knows it; to be read after :func:`prepare`."""
        model = self.inner_model
        return Craft(model.mass, model.inertia, self.allocation, self.moments, self.rotor_limit)


def prepare(params: UavParams) -> UavParams:
    """Check the vehicle, and set the numbers that follow from the nominal vehicle.

    Raises:
        ConfigError: The vehicle cannot fly, a place or velocity has not three values, or a rule of a part is broken.
    """
    vehicle = params.vehicle
    try:
        allocation = flying_allocation(vehicle)
    except ConfigError as error:
        raise error.within_path("vehicle") from None
    for name in ("position", "velocity", "body_rate"):
        if len(getattr(params, name)) != 3:
            raise ConfigError(name, f"needs three values, got {len(getattr(params, name))}")
    believed = completed_belief(params.believed, vehicle)
    if params.inner_loop.start is Start.SETTLED:
        require_known_equilibrium(params)
    return params._replace(
        ground=None if params.ground is None else prepared_ground(params.ground, vehicle.mass),
        battery=None if params.battery is None else checked_battery(params.battery, vehicle),
        believed=believed,
        allocation=allocation,
        hover_shares=hover_shares(vehicle, allocation),
        moments=tuple(map(tuple, geometry(vehicle)[1:].tolist())),
        believed_rotors=believed_rotors(params),
        rotor_limit=vehicle.nominal_thrust_limit,
    )


def completed_belief(believed: Believed, vehicle: Vehicle) -> Believed:
    """What the inner loop believes, with the vehicle's nominal values in place of numbers that are None.

    Raises:
        ConfigError: The believed inertia has not three values.
    """
    stated_values = {name: value for name, value in believed._asdict().items() if value is not None}
    if believed.inertia is not None and len(believed.inertia) != 3:
        raise ConfigError("believed.inertia", f"needs three values, got {believed.inertia}")
    nominal_inertia = vehicle._replace(
        body_inertia=tuple(nominal(value) for value in vehicle.body_inertia),
        rotor_inertia_xy=nominal(vehicle.rotor_inertia_xy),
        rotor_inertia_z=nominal(vehicle.rotor_inertia_z),
    ).inertia
    vehicle_values = Believed(
        mass=nominal(vehicle.mass),
        inertia=tuple(nominal_inertia),
        thrust_coefficient=nominal(vehicle.thrust_coefficient),
    )
    return vehicle_values._replace(**stated_values)


def require_known_equilibrium(params: UavParams) -> None:
    """Require that the integrals can settle at the start: that the weight alone determines their equilibrium.

    A battery changes the thrust. Rotors at given places add a moment where they differ from what the inner loop
    believes: where their numbers have laws, or where the believed thrust coefficient is stated.

    Raises:
        ConfigError: The vehicle has a battery, or such rotors.
    """
    rule = "'settled' is the equilibrium of the weight, and"
    remedy = "set 'zero', and give velocity_integral and rate_integral numbers or laws"
    if params.battery is not None:
        raise ConfigError("inner_loop.start", f"{rule} the thrust depends on a battery: {remedy}")
    rotors = params.vehicle.rotor
    differs = bool(rotors) and params.believed.thrust_coefficient is not None
    if differs or any(map(has_law, rotors)):
        raise ConfigError("inner_loop.start", f"{rule} rotors that differ from what is believed add a moment: {remedy}")


def has_law(rotor: Rotor) -> bool:
    """Whether a number of a rotor has a law, so that it differs from draw to draw."""
    for number in (*rotor.position, *rotor.axis, rotor.thrust_coefficient, rotor.torque_coefficient):
        if number is None:  # a coefficient of the vehicle, which all rotors share
            continue
        low, high = extent(number)
        if low != high:
            return True
    return False


def hover_shares(vehicle: Vehicle, allocation: tuple[tuple[float, ...], ...]) -> tuple[float, ...]:
    """Each rotor's share of the weight in hover; () for equal shares of rotors on a circle.

    Args:
        vehicle: The vehicle.
        allocation: The nominal allocation, shape (n_r, 4); its first column has the shares.
    """
    shares = tuple(row[0] for row in allocation)  # the column of the net thrust
    are_equal = all(abs(share - 1.0 / vehicle.rotors) < EQUAL_SHARE for share in shares)
    is_circle = not vehicle.rotor
    return () if is_circle and are_equal else shares


def believed_rotors(params: UavParams) -> tuple[float, ...]:
    """The k_T that the inner loop believes of each rotor with a given place [N s^2/rad^2]; () for rotors on a circle.

    The value is the one that ``[plant.believed]`` states, or else each rotor's own nominal value.
    """
    vehicle = params.vehicle
    if not vehicle.rotor:
        return ()
    stated_coefficient = params.believed.thrust_coefficient
    if stated_coefficient is not None:
        return (nominal(stated_coefficient),) * vehicle.rotors
    return tuple(map(nominal, vehicle.thrust_coefficients))
