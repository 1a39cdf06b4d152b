"""Recorded flights of a study in strict arithmetic: inputs and states of its software on board, tick by tick."""

from collections.abc import Callable, Iterator
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.between_samples.fixed_steps import advance_by_steps
from dssc_jax.closed_loop.estimates import estimation_of
from dssc_jax.closed_loop.first_state import initial_state
from dssc_jax.closed_loop.sample import LoopState, held_parts, step
from dssc_jax.core.numerics import as_arrays
from dssc_jax.core.signals import PlantInput, Scalar, State
from dssc_jax.engine.sampling import draw_key
from dssc_jax.flight_code.onboard import TracedSoftware, without_software
from dssc_jax.flight_code.replay_bench import recorded_columns
from dssc_jax.study import Study

NO_FLAGS = 0.0
"""The flags of a tick without a fault, as a number of a row."""

Row: TypeAlias = tuple[Scalar, ...]
"""Numbers of one tick: readings, commands and parameters with a law; then the results: no flags, and the states."""


def recording_lane(
    study: Study, traced: TracedSoftware, samples: int
) -> Callable[[dict[str, Scalar], jax.Array], list[Row]]:
    """Make the program that records a draw: ``(numbers by name, draw index) -> rows``, one for each tick of a sample.

    Each member of a row is a column of shape (samples,).

    Args:
        study: The study.
        traced: The software on board.
        samples: Number of samples of the loop.
    """
    uncertain_keys = [parameter.key for parameter in traced.parameters if parameter.uncertain]
    loop = study.loop
    software = loop.mimo_plant.software
    assert software is not None

    def lane(values: dict[str, Scalar], index: jax.Array) -> list[Row]:
        """Simulate a draw, and return the rows of its ticks."""
        params = study.params(values)
        key = draw_key(study.config.seed, index)
        real = jnp.result_type(float)
        gains = tuple(values[uncertain] for uncertain in uncertain_keys)
        estimation = estimation_of(loop, params)

        def measured_state(state: State) -> State:
            """The plant's state as the software measures it."""
            estimated_state = state if estimation is None else estimation.estimated_state(params.plant, state)
            return without_software(software, estimated_state)

        def sample(carry: tuple[LoopState, Scalar], _: None) -> tuple[tuple[LoopState, Scalar], list[Row]]:
            """Simulate one sample of the loop, and record each of its ticks."""
            state, k = carry
            rows: list[Row] = []

            def record_tick(earlier: State, drive: PlantInput, after: State) -> None:
                """Add the row of a tick, between two states of the plant.

                Args:
                    earlier: The state before the tick.
                    drive: The plant's input during the tick.
                    after: The state after the tick.
                """
                readings = jax.tree.leaves(measured_state(earlier))
                commands = (u + d for u, d in zip(drive.command, drive.disturbance, strict=True))
                states = jax.tree.leaves(software.held(after))
                row = (*readings, *commands, *gains, NO_FLAGS, *states)
                rows.append(tuple(jnp.asarray(number, real) for number in row))

            advance = advance_by_steps(held_parts(loop), params.plant, params.unmodelled, record_tick)
            next_state, _recorded = step(loop, params, key, state, k, advance)
            return (next_state, k + 1), rows

        start = initial_state(loop, params, key)
        held = software.start(params.plant, measured_state(start.plant), None)  # None: as in C, it never settles
        start = as_arrays(start._replace(plant=software.holding(start.plant, held)))
        first_sample = jnp.zeros((), jnp.int32)
        _, rows = jax.lax.scan(sample, (start, first_sample), length=samples)
        return rows

    return lane


def recorded_ticks(study: Study, traced: TracedSoftware, draws: int, samples: int) -> Iterator[np.ndarray]:
    """The rows of the first draws of a study, shape (ticks, numbers of a row) for each draw.

    A flight ends before the first row with a number that is not finite, where the software in C keeps its old state.

    Args:
        study: The study.
        traced: The software on board.
        draws: Number of draws.
        samples: Number of samples of the loop in each draw.
    """
    lane = recording_lane(study, traced, samples)
    constants = {parameter.key: parameter.value for parameter in traced.parameters}
    for _, ticks in recorded_columns(study, lane, draws, constants):
        rows_of_ticks = [np.stack(columns, axis=1) for columns in ticks]  # (samples, numbers) for each tick of a sample
        _, numbers = rows_of_ticks[0].shape
        rows = np.stack(rows_of_ticks, axis=1).reshape(-1, numbers)
        is_finite = np.isfinite(rows).all(axis=1)
        finite_rows = len(rows) if is_finite.all() else int(np.argmin(is_finite))
        yield rows[:finite_rows]
