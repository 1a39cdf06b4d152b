"""Software on board of a plant: it is sampled faster than the loop, and its results are held between its samples."""

from collections.abc import Callable
from typing import NamedTuple

from dssc_jax.core.default_functions import never
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import Params, PlantInput, Scalar, State
from dssc_jax.core.vectors import Vec3

WHOLE = 1e-9
"""Relative deviation of a ratio that counts as a whole number."""


def no_strings(params: Params) -> tuple[str, ...]:
    """Return an empty tuple for all parameters: the default of fields that list sentences or names."""
    return ()


class Onboard(NamedTuple):
    """Sampled software that is part of a plant, such as the inner loops of an autopilot.

    The results of the software are part of the plant's state, and ``derivative`` leaves them constant. At a sample of
    the loop, ``sample`` runs first, then ``tick``. Between two samples, ``tick`` alone runs at instants that divide the
    sample evenly.

    Args:
        period: ``(params) -> time between two ticks [s]``; None: these parameters choose no sampled software.
        start: ``(params, state, wind) -> held``: the software's part of the plant's state at the first sample, from the
            other parts and the mean wind at the start [m/s], which is None without a wind.
        held: ``(state) -> held``: the software's part of the plant's state.
        holding: ``(state, held) -> state`` with the software's part replaced.
        sample: ``(params, state, input, dt) -> state`` at each sample of the loop, of length dt.
        tick: ``(params, state, dt) -> state`` at each tick, dt apart.
        frequency: Name of the plant's number that gives the period, dotted, for messages.
        outputs: ``(params) -> sentences`` for the generated documentation, which say what the results drive.
        directions: Fields of the state that are vectors of length 1, such as a unit quaternion.
        integrals: ``(params) -> names`` of the plant's numbers, dotted, that are the start values of integrals.
        settled: ``(params) -> bool``: whether the integrals start in the equilibrium of the draw, to which the start
            values of ``integrals`` are added.
        drives: Field of ``held`` with the numbers that drive the actuators.
        tunable: Fields of the plant's parameters whose numbers the generated C may change in flight.
        taken_over: ``(params, state, driven, dt) -> (held, feasible)`` for a handover in steady motion, with samples dt
            apart [s]: the ``held`` with which the software continues to drive the actuators by the numbers ``driven``,
            and whether the limits of the software allow this. None: no handover is possible.
    """

    period: Callable[[Params], float | None]
    start: Callable[[Params, State, Vec3 | None], State]
    held: Callable[[State], State]
    holding: Callable[[State, State], State]
    sample: Callable[[Params, State, PlantInput, float], State]
    tick: Callable[[Params, State, float], State]
    frequency: str = ""
    outputs: Callable[[Params], tuple[str, ...]] = no_strings
    directions: tuple[str, ...] = ()
    integrals: Callable[[Params], tuple[str, ...]] = no_strings
    settled: Callable[[Params], bool] = never
    drives: str = ""
    tunable: tuple[str, ...] = ()
    taken_over: Callable[[Params, State, tuple[Scalar, ...], float], tuple[State, Scalar]] | None = None

    def check_clock(self, params: Params, sample_time: float, substeps: int) -> None:
        """Require that a sample has a whole number of ticks, and each tick a whole number of substeps.

        Args:
            params: The plant's parameters.
            sample_time: T_s [s].
            substeps: Integrator steps in a sample.

        Raises:
            ConfigError: The sample or a tick has no such whole number.
        """
        period = self.period(params)
        if period is None:
            return
        try:
            ticks_in_sample(period, sample_time, substeps)
        except ConfigError as error:
            raise error.within_path(self.frequency) from None


def ticks_in_sample(period: float, sample_time: float, substeps: int) -> int:
    """Return the number of ticks in a sample of the loop.

    Args:
        period: Time between two ticks [s].
        sample_time: T_s [s].
        substeps: Integrator steps in a sample.

    Raises:
        ConfigError: The period does not divide T_s, or the ticks do not divide the substeps.
    """
    ratio = sample_time / period
    ticks = round(ratio)
    if ticks < 1 or abs(ratio - ticks) > WHOLE * ratio:
        rule = f"must be a whole multiple of 1/loop.sample_time = {1.0 / sample_time:g} Hz"
        raise ConfigError("", f"{rule}, got {1.0 / period:g} Hz")
    if substeps % ticks:
        rule = f"gives {ticks} samples in T_s, which must divide loop.substeps = {substeps}"
        raise ConfigError("", f"{rule}; set loop.substeps = {ticks * max(1, round(substeps / ticks))}")
    return ticks
