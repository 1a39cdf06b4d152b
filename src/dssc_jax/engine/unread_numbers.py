"""Uncertain numbers of user-defined parts that their code does not read, so that their laws have no effect."""

import jax
import jax.numpy as jnp
from jax.interpreters.partial_eval import dce_jaxpr

from dssc_jax.closed_loop.draw import simulate_draw
from dssc_jax.closed_loop.rehearsal import user_functions
from dssc_jax.core.numerics import arithmetic, is_known
from dssc_jax.core.signals import Scalar
from dssc_jax.engine.batching import lane_names, margins_in, results_of
from dssc_jax.engine.sampling import draw_key
from dssc_jax.study import Study


def unread_numbers(study: Study) -> list[str]:
    """Names of the uncertain numbers of user-defined parts on which no result of a flight depends.

    The traced program decides, and not values. So a limit that no flight reaches counts as read. A parameter that
    follows from an unread number may still have an effect elsewhere.
    """
    slots = {function.part.partition(".")[0] for function in user_functions(study.loop).values()}
    if not slots or not study.laws:
        return []
    is_read_by_name: dict[str, bool] = {}

    def record_reads(values: dict[str, jax.Array], index: jax.Array) -> jax.Array:
        """Note in ``is_read_by_name`` which numbers the program of a lane reads; returns ``index`` unchanged.

        The function is only traced, for the sake of the note. JAX's elimination of dead code tells which inputs of the
        lane's program have an effect on its results.
        """
        numbers, structure = jax.tree.flatten(study.params(values))
        uncertain = [position for position, number in enumerate(numbers) if not is_known(number)]
        margins = margins_in(study, values)

        def results(traced_numbers: list[jax.Array]) -> dict[str, Scalar]:
            """The results of the lane's draw as a function of its uncertain parameters."""
            all_numbers = list(numbers)
            for position, number in zip(uncertain, traced_numbers, strict=True):
                all_numbers[position] = number
            params = jax.tree.unflatten(structure, all_numbers)
            key = draw_key(study.config.seed, index)
            criteria = study.measures, study.requirements
            run = simulate_draw(study.loop, params, key, *criteria, axis_name=None, margins=margins)
            return results_of(study, run)

        program = jax.make_jaxpr(results)([numbers[position] for position in uncertain]).jaxpr
        _, used_flags = dce_jaxpr(program, [True] * len(program.outvars))
        names = study.leaf_names()
        for position, is_used in zip(uncertain, used_flags, strict=True):
            name = names[position]
            is_read_by_name[name] = is_read_by_name.get(name, False) or is_used
        return index

    with arithmetic(study.config.loop.precision):
        number = jax.ShapeDtypeStruct((), jnp.result_type(float))
        jax.eval_shape(record_reads, dict.fromkeys(lane_names(study), number), jax.ShapeDtypeStruct((), jnp.uint32))
    unread_names = [name for name, is_read in is_read_by_name.items() if not is_read]
    return [name for name in unread_names if name.partition(".")[0] in slots]
