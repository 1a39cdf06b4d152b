"""Laws that change no result of a loop with parts of users: their code does not read the number."""

import jax
import jax.numpy as jnp
from jax.interpreters.partial_eval import dce_jaxpr

from dssc_jax.closed_loop.margin_measures import margins_of
from dssc_jax.closed_loop.rehearsal import user_functions
from dssc_jax.core.numerics import arithmetic
from dssc_jax.engine.batching import lane_of_study
from dssc_jax.study import Study


def unused_laws(study: Study) -> list[str]:
    """The names of laws on which no result of a flight depends.

    It follows from the program, not from values, so a limit that is not reached counts as used. A loop of this
    package's parts has none.

    Args:
        study: The study.
    """
    names = list(study.laws)
    if not names or not user_functions(study.loop):
        return []
    others = [*study.axes, *margins_of(study.measures)]
    with arithmetic(study.config.loop.precision):
        number = jax.ShapeDtypeStruct((), jnp.result_type(float))
        index = jax.ShapeDtypeStruct((), jnp.uint32)
        lane = lane_of_study(study, axis_name=None)

        def results(chosen: list[jax.Array], remaining: list[jax.Array], draw: jax.Array) -> object:
            return lane(dict(zip([*names, *others], [*chosen, *remaining], strict=True)), draw)

        program = jax.make_jaxpr(results)([number] * len(names), [number] * len(others), index).jaxpr
    _, used = dce_jaxpr(program, [True] * len(program.outvars))
    return [name for name, is_used in zip(names, used, strict=False) if not is_used]
