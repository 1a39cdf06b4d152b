"""Uncertain numbers of users' parts that their code does not read, so that their laws change nothing."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jax.interpreters.partial_eval import dce_jaxpr
from jax.tree_util import GetAttrKey, KeyEntry, SequenceKey, tree_flatten_with_path

from dssc_jax.closed_loop.draw import simulate_draw
from dssc_jax.closed_loop.margin_measures import margins_of
from dssc_jax.closed_loop.rehearsal import user_functions
from dssc_jax.core.numerics import arithmetic, is_known
from dssc_jax.core.signals import Scalar
from dssc_jax.engine.batching import results_of
from dssc_jax.engine.sampling import draw_key
from dssc_jax.study import Study


def unread_numbers(study: Study) -> list[str]:
    """The names of uncertain numbers of users' parts on which no result of a flight depends.

    It follows from the program, not from values, so a limit that is not reached counts as read. A number may still have
    an effect elsewhere, by the name of a parameter.

    Args:
        study: The study.
    """
    parts = {function.part for function in user_functions(study.loop).values()}
    if not parts or not study.laws:
        return []
    found: list[str] = []

    def trace(values: dict[str, jax.Array], index: jax.Array) -> jax.Array:
        leaves, structure = tree_flatten_with_path(study.params(values))
        numbers = [number for _, number in leaves]
        uncertain = [place for place, number in enumerate(numbers) if not is_known(number)]
        margins = {name: values[name] for name in margins_of(study.measures)}

        def results(chosen: list[jax.Array]) -> dict[str, Scalar]:
            filled = list(numbers)
            for place, number in zip(uncertain, chosen, strict=True):
                filled[place] = number
            params = jax.tree.unflatten(structure, filled)
            key = draw_key(study.config.seed, index)
            judged = study.measures, study.requirements
            return results_of(study, simulate_draw(study.loop, params, key, *judged, axis_name=None, margins=margins))

        program = jax.make_jaxpr(results)([numbers[place] for place in uncertain]).jaxpr
        _, read = dce_jaxpr(program, [True] * len(program.outvars))
        for place, is_read in zip(uncertain, read, strict=True):
            name = name_of_number(leaves[place][0], study.loop.channels)
            if not is_read and any(name.startswith(f"{part}.") for part in parts):
                found.append(name)
        return index

    names = [*study.laws, *study.axes, *margins_of(study.measures)]
    with arithmetic(study.config.loop.precision):
        number = jax.ShapeDtypeStruct((), jnp.result_type(float))
        jax.eval_shape(trace, dict.fromkeys(names, number), jax.ShapeDtypeStruct((), jnp.uint32))
    return found


def name_of_number(path: Sequence[KeyEntry], channels: Sequence[str]) -> str:
    """The dotted name of a parameter of the loop; the first index of a slot is that of a channel."""
    words: list[str] = []
    for entry in path:
        if isinstance(entry, GetAttrKey):
            words.append(entry.name)
        elif isinstance(entry, SequenceKey) and len(words) == 1:
            words.append(channels[int(entry.idx)])
        elif isinstance(entry, SequenceKey):
            words.append(str(entry.idx))
    return ".".join(filter(None, words))
