"""The analysed controller of a channel, fed with logged measurements: the command that it would have given."""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.control import ControlState, control, initial_control
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import arithmetic, as_arrays
from dssc_jax.core.signals import Measurement, ReferencePoint
from dssc_jax.engine.plain import plain_options
from dssc_jax.flight_logs.hints.references import median_values
from dssc_jax.flight_logs.reading.coverage import few_samples_remedy
from dssc_jax.flight_logs.reading.reader import forward_filled
from dssc_jax.study import Study

REPLAY_SHARE = 0.95
"""Share of the samples at which a replay needs the measured output."""
NO_NUMBERS: Mapping[str, float] = MappingProxyType({})
REFERENCE_TOLERANCE = 1e-3  # share of a reference's size: resolution and rounding of a log


class ChannelReplay:
    """The analysed differentiator and controller of a channel, compiled once for any number of replays.

    Both start at the first sample, as after a reset. Numbers with laws have the medians of their laws.

    Args:
        study: The study, without a sweep.
        index: Position of the channel.
        reference: The study's reference with two derivatives, shape (3, samples).
        sample_time: Time between two samples that the software believes, for integrals and derivatives [s]; None: T_s.
    """

    def __init__(self, study: Study, index: int, reference: np.ndarray, sample_time: float | None = None) -> None:
        self.study = study
        self.index = index
        self.reference = reference
        self.sample_time = study.loop.sample_time if sample_time is None else sample_time
        self._compiled = jax.jit(self._commands, compiler_options=plain_options())

    def _commands(
        self, columns: tuple[Measurement, ReferencePoint], numbers: Mapping[str, jax.Array | float]
    ) -> jax.Array:
        """The command at each sample, shape (samples,), in JAX.

        Args:
            columns: Measurements and references, every field of shape (samples,).
            numbers: Values of numbers that replace the study's or the medians of their laws, by name.
        """
        loop = replace(self.study.loop, sample_time=self.sample_time)
        params = self.study.params({**median_values(self.study), **numbers})

        def sample(state: ControlState, signals: tuple[Measurement, ReferencePoint]) -> tuple[ControlState, jax.Array]:
            """One sample: the controller's state after it, and its command."""
            next_state, controlled = control(loop, params, self.index, state, *signals)
            return as_arrays(next_state), jnp.asarray(controlled.command.total)

        first = jax.tree.map(lambda column: column[0], columns)
        initial = as_arrays(initial_control(loop, params, self.index, *first))
        return jax.lax.scan(sample, initial, columns)[1]

    def raw_command(
        self, readings: np.ndarray, references: np.ndarray, numbers: Mapping[str, float] = NO_NUMBERS
    ) -> np.ndarray:
        """Compute the command for measurements and desired outputs.

        Args:
            readings: Measured output and its derivative, shape (2, samples).
            references: Desired output with two derivatives, shape (3, samples).
            numbers: Values of numbers that replace the study's or the medians of their laws, by name.

        Returns:
            The command u + u_n, shape (samples,).

        Raises:
            ConfigError: The controller takes signals that a log does not have.
        """
        if self.study.loop.controller[self.index].takes(self.study.template.controller[self.index]):
            raise ConfigError("controller", "takes measured signals beside y and y', which a log does not have")
        with arithmetic(self.study.config.loop.precision):
            real = jnp.result_type(float)
            measurement = Measurement(*jnp.asarray(readings, real))
            reference = ReferencePoint(*jnp.asarray(references, real))
            return np.asarray(self._compiled((measurement, reference), dict(numbers)), float)

    def command(self, logged: Mapping[str, np.ndarray], numbers: Mapping[str, float] = NO_NUMBERS) -> np.ndarray | str:
        """The command for a channel's sampled log, or why there is none.

        If the log has no reference, or that of the study, the study's signals replace those that the log lacks.

        Args:
            logged: Signals by their names without the channel, NaN where missing, each of shape (samples,).
            numbers: Values of numbers that replace the study's or the medians of their laws, by name.

        Returns:
            The command, shape (samples,), or the reason in words.
        """
        if "y" not in logged:
            return "the log has no measured output y"
        if not has_enough_outputs(logged):
            share = float(np.mean(np.isfinite(logged["y"])))
            sample_time = self.study.loop.sample_time
            return (
                f"the log has y at {100 * share:.3g} % of the controller's samples; a replay needs "
                f"{100 * REPLAY_SHARE:g} %, and makes up none: "
                f"{few_samples_remedy(np.isfinite(logged['y']), sample_time)}"
            )
        signals = {name: forward_filled(values) for name, values in logged.items() if np.isfinite(values).any()}
        defaults = {"y_ref": self.reference[0]}
        if "y_ref" not in signals or is_close(signals["y_ref"], self.reference[0]):
            defaults |= {"y_ref_dot": self.reference[1], "y_ref_ddot": self.reference[2]}
        signals = {**defaults, **signals}
        missing = [name for name in ("y_dot", "y_ref_dot", "y_ref_ddot") if name not in signals]
        for name in missing:
            signals[name] = np.full(len(signals["y"]), np.nan)
        readings = np.array([signals["y"], signals["y_dot"]])
        desired = np.array([signals["y_ref"], signals["y_ref_dot"], signals["y_ref_ddot"]])
        command = self.raw_command(readings, desired, numbers)
        if np.isfinite(command).all():
            return command
        if missing:
            return f"the controller needs {' or '.join(missing)}, which the log lacks"
        return "the controller's command is not finite for these measurements"


def has_enough_outputs(logged: Mapping[str, np.ndarray]) -> bool:
    """Whether a channel's sampled log has its output, NaN where missing, at as many samples as a replay needs."""
    return "y" in logged and float(np.mean(np.isfinite(logged["y"]))) >= REPLAY_SHARE


def analysed_command(study: Study, index: int, readings: np.ndarray, references: np.ndarray) -> np.ndarray:
    """Compute the command that a channel's analysed controller gives for logged measurements.

    Args:
        study: The study, without a sweep.
        index: Position of the channel.
        readings: Measured output and its derivative, shape (2, samples).
        references: Desired output with two derivatives, shape (3, samples).

    Returns:
        The command u + u_n, shape (samples,).
    """
    return ChannelReplay(study, index, references).raw_command(readings, references)


def replayed_channel(
    study: Study, index: int, logged: Mapping[str, np.ndarray], reference: np.ndarray
) -> np.ndarray | str:
    """The command of the analysed controller for a channel's sampled log, or why there is none.

    If the log has no reference, or that of the study, the study's reference and its derivatives, shape (3, samples),
    replace those that the log lacks.
    """
    return ChannelReplay(study, index, reference).command(logged)


def is_close(logged: np.ndarray, reference: np.ndarray) -> bool:
    """Whether a logged reference is that of the study, up to resolution and rounding; both of shape (samples,)."""
    largest = max(float(np.abs(reference).max()), float(np.ptp(reference)), 1e-300)
    return float(np.abs(logged - reference).max()) <= REFERENCE_TOLERANCE * largest
