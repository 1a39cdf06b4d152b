"""Calls of functions of C in a lane's program."""

from collections.abc import Sequence
from typing import Any

from jax.extend.core import JaxprEqn

from dssc_jax.lanes.builder import Builder
from dssc_jax.lanes.foreign import FOREIGN_CALL
from dssc_jax.lanes.program import Value
from dssc_jax.lanes.tracing.specification import NUMBER_TYPES, Parameters, TranslationRule, any_value, rule


def foreign_call(build: Builder, operands: Sequence[Any], params: Parameters, equation: JaxprEqn) -> list[Value]:
    """Translate a call of a function of C in each lane; return the results of the call.

    The arguments are those of all translations; see :mod:`~dssc_jax.lanes.tracing.arrays`.
    """
    return build.foreign(params["function"], operands)


FOREIGN_RULES: dict[str, TranslationRule] = {FOREIGN_CALL: rule(foreign_call, NUMBER_TYPES, function=any_value)}
"""The rule of the primitive that calls C, by its name."""
