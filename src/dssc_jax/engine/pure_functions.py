"""The closed loop as pure functions of JAX: a whole draw, and a single sample.

They add no batch axis and no compilation, so ``jit``, ``vmap``, ``grad`` and ``scan`` apply to them as to any
function. Their results are those of :func:`dssc_jax.run`, up to the rounding of another compiler.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.first_state import initial_state
from dssc_jax.closed_loop.metrics.margin_measures import margins_of
from dssc_jax.closed_loop.sample import LoopState, Recorded, step
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.signals import Scalar
from dssc_jax.engine.batching import Lane, lane_numbers, lane_of_study
from dssc_jax.engine.evaluation import require_steps_in_any_order
from dssc_jax.engine.sampling import Arrays, draw_key
from dssc_jax.study import Study

Values = Mapping[str, Scalar]
"""Numbers of a study by their dotted names."""


class StepState(NamedTuple):
    """State of a :class:`Stepper` between two samples.

    Args:
        k: Index of the next sample.
        loop: State of the loop.
        values: The draw's numbers by dotted name.
        key: The draw's random key.
    """

    k: Scalar
    loop: LoopState
    values: dict[str, jax.Array]
    key: jax.Array


def require_values(study: Study, values: Values) -> None:
    """Require a value for each uncertain or swept number of the study, and JAX in the study's precision.

    Args:
        study: The study.
        values: Numbers by their dotted names.

    Raises:
        ConfigError: A value is missing, a name is not that of a number that a trace can set, or JAX has another
            precision.
    """
    for name in (*study.axes, *study.laws):
        if name not in values:
            raise ConfigError(name, "is uncertain or swept in this study, so values must contain it")
    for name in values:
        if name not in study.numbers:
            raise ConfigError(name, f"is no number of this study; {nearest(name, study.numbers)}")
        if study.numbers[name].expression:
            raise ConfigError(name, study.numbers[name].follows)
        if not study.numbers[name].quantity.law:
            raise ConfigError(name, "is fixed before tracing; change it with study.override")
    bits = 8 * jnp.result_type(float).itemsize  # of JAX's real numbers: 32 or 64
    if bits != study.config.loop.precision:
        enabled = study.config.loop.precision == 64
        rule = f"is {study.config.loop.precision}, and JAX computes in {bits} bits"
        raise ConfigError("loop.precision", f"{rule}; set jax.config.update('jax_enable_x64', {enabled})")


def real_numbers(values: Values) -> dict[str, jax.Array]:
    """Values by name as JAX's real numbers, in the precision that is in use."""
    return {name: jnp.asarray(value, jnp.result_type(float)) for name, value in values.items()}


def drawn_values(study: Study, indices: np.ndarray) -> Arrays:
    """Values of all uncertain and swept numbers in n draws, by name, shape (n,) each.

    A swept number has the first value of its sweep.

    Args:
        study: The study.
        indices: Draw indices, shape (n,).
    """
    first_point = [np.zeros(len(indices), int)] * len(study.axes)
    return lane_numbers(study, (*first_point, indices))


@dataclass(frozen=True, eq=False)
class LaneFunction:
    """The pure function of one draw, ``(values, index) -> results``; see :func:`lane`.

    Args:
        study: The study.
        compute: The program of a lane, without checks of its arguments.
    """

    study: Study
    compute: Lane

    def __call__(self, values: Values, index: Scalar) -> dict[str, Scalar]:
        """Metrics, slacks, outcome and time of the early end of one draw.

        Args:
            values: The draw's numbers by dotted name: every uncertain or swept number, and any other number that
                differs from the study's. Expressions follow from these values. Quantities that a model computed from
                the study's numbers before tracing keep their values; ``study.override`` computes them again.
            index: Index of the draw, which selects its noise.

        Raises:
            ConfigError: A number is missing or unknown, or JAX has another precision than the study.
        """
        require_values(self.study, values)
        return self.compute(real_numbers(values), jnp.asarray(index, jnp.uint32))

    @property
    def example(self) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Arguments of the function: values and index of the first draw."""
        indices = np.zeros(1, dtype=np.uint32)
        columns = drawn_values(self.study, indices)
        return {name: column[0] for name, column in columns.items()}, indices[0]

    def draws(self, count: int | None = None) -> tuple[Arrays, np.ndarray]:
        """Values and indices of the first draws, for ``jax.vmap``: the same draws as :func:`dssc_jax.run` simulates.

        Args:
            count: Number of draws; None: as many as the study has.

        Returns:
            Values by dotted name, shape (count,) each, and the indices, shape (count,). A swept number has its first
            value.

        Raises:
            ConfigError: ``count`` is below 1, or above the study's number of draws, or the run chooses the design of
                its draws (``sampling = "auto"``).
        """
        draws = self.study.config.draws
        if self.study.config.sampling == "auto":
            raise ConfigError(
                f"{self.study.source}: sampling",
                "is 'auto', so that a run chooses its draws after a pilot; take the study of its result "
                "(dj.lane(result.study)), or set sampling to 'random', 'sobol' or 'lhs'",
            )
        if count is not None and not 1 <= count <= draws:
            raise ConfigError("count", f"must be in 1 .. {draws}, the draws of the study, got {count}")
        indices = np.arange(draws if count is None else count, dtype=np.uint32)
        return drawn_values(self.study, indices), indices


@dataclass(frozen=True, eq=False)
class Stepper:
    """The loop as two pure functions, ``init`` and ``step``; see :func:`stepper`."""

    study: Study

    @property
    def example(self) -> tuple[dict[str, np.ndarray], jax.Array]:
        """Arguments of :meth:`init`: values and random key of the first draw."""
        columns = drawn_values(self.study, np.zeros(1, int))
        return {name: column[0] for name, column in columns.items()}, self.key(0)

    def key(self, index: jax.Array | int) -> jax.Array:
        """The random key of a draw of the study."""
        return draw_key(self.study.config.seed, index)

    def init(self, values: Values, key: jax.Array) -> StepState:
        """The state before the first sample.

        Args:
            values: The draw's numbers by dotted name; see :class:`LaneFunction`.
            key: The draw's random key.

        Raises:
            ConfigError: As for :class:`LaneFunction`.
        """
        require_values(self.study, values)
        numbers = real_numbers(values)
        loop = initial_state(self.study.loop, self.study.params(numbers), key)
        return StepState(jnp.zeros((), jnp.int32), loop, numbers, key)

    def step(self, state: StepState) -> tuple[StepState, Recorded]:
        """Advance the loop by one sample: measure, control, and integrate to the next sample.

        Every call computes the matrix exponentials of linear parts again.

        Args:
            state: The state before the sample.

        Returns:
            The next state, and a record ``info`` of this sample. The record has the signals of each channel
            (``info.instant.channels``), the plant's outputs, the desired outputs, and inputs and outputs of the
            controllers (``info.controlled``). It also tells whether the state is still finite and the model valid.
        """
        params = self.study.params(state.values)
        next_state, info = step(self.study.loop, params, state.key, state.loop, state.k)
        return StepState(state.k + 1, next_state, state.values, state.key), info


def lane(study: Study, segment: int | None = None) -> LaneFunction:
    """The pure function of one draw, ``lane(values, index) -> results``, for ``jit``, ``vmap`` and ``grad``.

    ``lane.example`` gives the function's arguments for the first draw, and ``lane.draws(n)`` gives the arguments of n
    draws for ``vmap``. Metrics and slacks are differentiable in every value. A draw that ends early has metrics NaN and
    slacks -inf.

    Args:
        study: The study.
        segment: Number of samples between the checkpoints that reverse mode stores; it computes the samples between two
            checkpoints again. None: it stores every sample.

    Raises:
        ConfigError: The segment has no sample, a margin of the linearised loop is required, or a part keeps its state
            outside of JAX.

    Example:
        >>> import jax
        >>> import dssc_jax as dj
        >>> lane = dj.lane(dj.Study.load("motor"))
        >>> values, indices = lane.draws(3)
        >>> with jax.enable_x64(True):
        ...     results = jax.jit(jax.vmap(lane))(values, indices)
        >>> results["error_rms"].shape
        (3,)
    """
    if segment is not None and segment < 1:
        raise ConfigError("segment", f"must be at least 1 sample, got {segment}")
    study.require_single_laws()
    require_steps_in_any_order(study, "a pure function of the flight")
    margins = list(margins_of(study.measures))
    if margins:
        rule = f"{margins[0]} is that of the linearised loop, which a pure function of the flight does not have"
        raise ConfigError(study.source, f"{rule}; take the requirement out, or use `run`")
    return LaneFunction(study, lane_of_study(study, axis_name=None, segment=segment))


def stepper(study: Study) -> Stepper:
    """The loop as ``init(values, key) -> state`` and ``step(state) -> (state, info)``, for a user's own time loop.

    Args:
        study: The study.

    Raises:
        ConfigError: A part keeps its state outside of JAX.

    Example:
        >>> import jax
        >>> import dssc_jax as dj
        >>> loop = dj.stepper(dj.Study.load("motor"))
        >>> with jax.enable_x64(True):
        ...     state = loop.init(*loop.example)
        ...     state, info = jax.lax.scan(lambda state, _: loop.step(state), state, length=100)
        >>> info.instant.channels[0].e.shape
        (100,)
    """
    study.require_single_laws()
    require_steps_in_any_order(study, "a step as a pure function")
    return Stepper(study)
