"""Premises that a monitor checks: the bounds of a certificate as numbers, and a flag for each."""

from dataclasses import dataclass, replace
from typing import NamedTuple, TypeAlias

import numpy as np

from dssc_jax.core.units import ChannelUnits

Interval: TypeAlias = tuple[float, float]
"""Both ends of an interval."""


class Flag(NamedTuple):
    """A flag of the monitor: its name in C, without the study's prefix, and its meaning in a sentence."""

    name: str
    sentence: str


@dataclass(frozen=True)
class DisturbancePremises:
    """Premises of a certificate of one axis about the plant y'' = -a_p y' + k_p (G(mu s) u + d).

    Args:
        level: Bound of |d|, in the unit of the command.
        slope: Bound of |d'|, in the unit of the command per second.
        k_p: Interval of the high-frequency gain.
        a_p: Interval of the damping [1/s].
        mu: Interval of the lag's time constant [s]; (0, 0): there is no lag.
        lag_order: Number of first-order lags 1/(mu s + 1) between command and plant.
        delay_weights: Weights with which the commands of 0, 1, ... samples ago enter the mean command after the delay.
    """

    level: float
    slope: float
    k_p: Interval
    a_p: Interval
    mu: Interval = (0.0, 0.0)
    lag_order: int = 0
    delay_weights: tuple[float, ...] = (1.0,)


@dataclass(frozen=True)
class ChannelPremises:
    """The bounds of one channel, in the channel's units.

    Args:
        label: Name in C; empty for the only channel.
        l0: Error pole l_0 of sigma = e' + l_0 e [1/s].
        angle: Whether the output is an angle, whose error is wrapped.
        e: Bound of |e|.
        e_dot: Bound of |e'|; None: the certificate states none.
        sigma: Bound of |sigma|.
        sigma_slope: Bound of |sigma'|; None: the certificate states none.
        slides: Whether the controller has a clip, which must not be active.
        start: Intervals of e and e' at the first sample; None: ``plane_start`` of the flight bounds them.
        disturbance: Bounds of the disturbance; None: the measurements do not determine it.
        units: Units of the output and of the command.
    """

    label: str
    l0: float
    angle: bool
    e: float
    e_dot: float | None
    sigma: float
    sigma_slope: float | None
    slides: bool
    start: tuple[Interval, Interval] | None
    disturbance: DisturbancePremises | None
    units: ChannelUnits

    def flags(self) -> list[Flag]:
        """The channel's flags, in the order of their bits."""
        y = self.units.of("y")
        rate = self.units.of("y/s")
        change = self.units.of("y/s^2")  # of sigma'
        place = f" of {self.label}" if self.label else ""
        channel_flags = [Flag("e", f"|e|{place} exceeds {self.e:.4g} {y}, the certificate's bound.")]
        if self.e_dot is not None:
            channel_flags.append(
                Flag("e_dot", f"|e'|{place} exceeds {self.e_dot:.4g} {rate}, the certificate's bound.")
            )
        channel_flags.append(Flag("sigma", f"|sigma|{place} exceeds {self.sigma:.4g} {rate}, the certificate's bound."))
        if self.sigma_slope is not None:
            bound = f"{self.sigma_slope:.4g} {change}"
            text = f"sigma{place} changes faster than {bound}: what acts on the channel is too large or too sudden."
            channel_flags.append(Flag("sigma_slope", text))
        if self.slides:
            text = f"The equivalent control{place} exceeds rho: the clip is active, and the loop does not slide."
            channel_flags.append(Flag("sliding", text))
        if self.disturbance is not None:
            level = f"{self.disturbance.level:.4g} {self.units.of('u')}"
            slope = f"{self.disturbance.slope:.4g} {self.units.of('u/s')}"
            channel_flags.append(Flag("disturbance", f"The disturbance{place} that the plant shows exceeds {level}."))
            channel_flags.append(Flag("disturbance_slope", f"The disturbance{place} changes faster than {slope}."))
        prefix = f"{self.label}_" if self.label else ""
        return [flag._replace(name=prefix + flag.name) for flag in channel_flags]


@dataclass(frozen=True)
class Premises:
    """The bounds of a flight that a verified certificate states.

    Args:
        sample_time: T_s [s].
        channels: The bounds of each channel of the loop.
        plane_start: Bounds of the norms of (e_x, e_y) [m] and (e_x', e_y') [m/s] at the first sample; None: there are
            none.
        tilt: Bound of the tilt [rad]; None: there is none.
        rotors: Interval of the rotors' commanded thrusts [N]; None: there is none.
        rotor_count: Number of rotors.
        statement: The statement of the certificate in words.
        unwatched: A sentence on the premises that the monitor cannot check; empty: it checks all.
    """

    sample_time: float
    channels: tuple[ChannelPremises, ...]
    plane_start: tuple[float, float] | None
    tilt: float | None
    rotors: Interval | None
    rotor_count: int
    statement: str
    unwatched: str

    def flags(self) -> tuple[Flag, ...]:
        """All flags, in the order of their bits."""
        start = "At the first sample e or e' is outside of the certificate's start: nothing is proved of this flight."
        flight_flags = [Flag("start", start)]
        for channel in self.channels:
            flight_flags += channel.flags()
        if self.tilt is not None:
            flight_flags.append(Flag("tilt", f"The tilt exceeds {self.tilt:.4g} rad, the certificate's bound."))
        if self.rotors is not None:
            low, high = self.rotors
            flight_flags.append(
                Flag("rotor_low", f"The command of a rotor is below {low:.5g} N, the certificate's bound.")
            )
            flight_flags.append(
                Flag("rotor_high", f"The command of a rotor is above {high:.5g} N, the certificate's bound.")
            )
        return tuple(flight_flags)

    def rounded(self, real: np.dtype) -> "Premises":
        """The same premises with bounds in another dtype, each rounded outwards."""
        channels = tuple(rounded_channel(channel, real) for channel in self.channels)
        plane_start = None
        if self.plane_start is not None:
            distance, speed = self.plane_start
            plane_start = (rounded_up(distance, real), rounded_up(speed, real))
        tilt = None if self.tilt is None else rounded_up(self.tilt, real)
        rotors = None if self.rotors is None else rounded_outwards(self.rotors, real)
        return replace(self, channels=channels, plane_start=plane_start, tilt=tilt, rotors=rotors)


def rounded_up(value: float, real: np.dtype) -> float:
    """The smallest number of a dtype that is not below a value.

    Args:
        value: The value, in double precision.
        real: The dtype.
    """
    nearest = real.type(value)
    if float(nearest) >= value:
        return float(nearest)
    return float(np.nextafter(nearest, real.type(np.inf)))


def rounded_outwards(interval: Interval, real: np.dtype) -> Interval:
    """The smallest interval with ends of a dtype that contains an interval."""
    low, high = interval
    return -rounded_up(-low, real), rounded_up(high, real)


def rounded_channel(channel: ChannelPremises, real: np.dtype) -> ChannelPremises:
    """The bounds of a channel in another dtype, rounded outwards.

    The bounds of the lag stay as they are; l0 is no bound, and stays, too.
    """
    disturbance = channel.disturbance
    if disturbance is not None:
        disturbance = replace(
            disturbance,
            level=rounded_up(disturbance.level, real),
            slope=rounded_up(disturbance.slope, real),
            k_p=rounded_outwards(disturbance.k_p, real),
            a_p=rounded_outwards(disturbance.a_p, real),
        )
    start = None
    if channel.start is not None:
        e, e_dot = channel.start
        start = (rounded_outwards(e, real), rounded_outwards(e_dot, real))
    return replace(
        channel,
        e=rounded_up(channel.e, real),
        e_dot=None if channel.e_dot is None else rounded_up(channel.e_dot, real),
        sigma=rounded_up(channel.sigma, real),
        sigma_slope=None if channel.sigma_slope is None else rounded_up(channel.sigma_slope, real),
        start=start,
        disturbance=disturbance,
    )
