"""Analysis of a trace, before its translation: the values that may differ between lanes, and are called varying.

The builder needs to know which states of a loop vary before it builds the loop's body. If an operand of an equation
varies, so do its results; in loops this is repeated until nothing changes.
"""

from collections.abc import Iterable, Sequence
from functools import reduce
from operator import or_
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal, Var

from dssc_jax.lanes.foreign import FOREIGN_CALL


def is_key(aval: Any) -> bool:
    """Whether values of this type are random keys."""
    return jnp.issubdtype(aval.dtype, jax.dtypes.prng_key)


def parts_of_scan(equation: JaxprEqn) -> tuple[int, int]:
    """The number of a scan's operands that are constants, and the number that are its state.

    JAX stores these two numbers up to version 0.10; from 0.11 on, it stores the tree of the operands.
    """
    params = equation.params
    if "ft_in" in params:
        constants, state, _ = params["ft_in"].update(equation.invars).unpack()
        return len(list(constants)), len(list(state))
    return params["num_consts"], params["num_carry"]


class VaryingResults:
    """Finds the results of a program that vary, from the operands that do.

    A *mask* is an integer that tells when a value varies. Bit 0: always; bit i + 1: if operand i of the program varies.
    The mask of a value that depends on several others is their bitwise "or".
    """

    def __init__(self) -> None:
        self._masks: dict[int, tuple[Jaxpr, list[int]]] = {}

    def of(self, jaxpr: Jaxpr, operands: Sequence[int]) -> list[int]:
        """The mask of each result of a jaxpr, from the mask of each operand.

        The masks in terms of the jaxpr's inputs are computed once. The jaxpr is stored with them, so that no other one
        can get its id.
        """
        if id(jaxpr) not in self._masks:
            scope: dict[Var, int] = {variable: 2 << i for i, variable in enumerate(jaxpr.invars)}

            def read(atoms: Iterable[Any]) -> list[int]:
                return [0 if isinstance(atom, Literal) else scope.get(atom, 0) for atom in atoms]

            for equation in jaxpr.eqns:
                scope.update(zip(equation.outvars, self._equation(equation, read(equation.invars)), strict=True))
            self._masks[id(jaxpr)] = jaxpr, read(jaxpr.outvars)
        return [varying_mask(mask, operands) for mask in self._masks[id(jaxpr)][1]]

    def of_while(
        self, head: Jaxpr, body: Jaxpr, operands: Sequence[int], first: int, second: int
    ) -> tuple[list[int], int]:
        """The mask of each state of a while loop, and the mask of its condition.

        Args:
            head: The loop's condition.
            body: The loop's body.
            operands: Masks of the condition's constants, the body's constants, and the initial states.
            first: Position of the body's first constant.
            second: Position of the first state.
        """
        head_constants = operands[:first]
        constants = operands[first:second]
        state = list(operands[second:])
        while True:
            condition = self.of(head, [*head_constants, *state])[0]
            body_masks = self.of(body, [*constants, *state])
            next_state = [old | new | condition for old, new in zip(state, body_masks, strict=True)]
            if next_state == state:
                return state, condition
            state = next_state

    def of_scan(self, body: Jaxpr, operands: Sequence[int], first: int, second: int) -> list[int]:
        """The mask of each state of a scan.

        Args:
            body: The scan's body.
            operands: Masks of the constants, the initial states, and the rows.
            first: Position of the first state.
            second: Position of the first row.
        """
        constants = operands[:first]
        state = list(operands[first:second])
        rows = operands[second:]
        while True:
            body_masks = self.of(body, [*constants, *state, *rows])
            next_state = [old | new for old, new in zip(state, body_masks, strict=False)]
            if next_state == state:
                return state
            state = next_state

    def _equation(self, equation: JaxprEqn, operands: list[int]) -> list[int]:
        """The masks of one equation's results, from the masks of its operands."""
        name = equation.primitive.name
        params = equation.params
        count = len(equation.outvars)
        if name.startswith("pmax"):
            return [0] * count
        if name == FOREIGN_CALL:
            return [1] * count
        if name == "while":
            first = params["cond_nconsts"]
            second = params["cond_nconsts"] + params["body_nconsts"]
            return self.of_while(params["cond_jaxpr"].jaxpr, params["body_jaxpr"].jaxpr, operands, first, second)[0]
        if name == "scan":
            constants, state_count = parts_of_scan(equation)
            state = self.of_scan(params["jaxpr"].jaxpr, operands, constants, constants + state_count)
            return [*state, *[1] * (count - len(state))]
        if name == "cond":
            index, *arguments = operands
            sides = [self.of(branch.jaxpr, arguments) for branch in params["branches"]]
            return [reduce(or_, masks, index) for masks in zip(*sides, strict=True)]
        inner = params.get("jaxpr", params.get("call_jaxpr"))
        if isinstance(inner, ClosedJaxpr | Jaxpr):
            jaxpr = inner.jaxpr if isinstance(inner, ClosedJaxpr) else inner
            if len(jaxpr.invars) == len(operands) and len(jaxpr.outvars) == count:
                return self.of(jaxpr, operands)
        return [reduce(or_, operands, 0)] * count


def varying_mask(mask: int, operands: Sequence[int]) -> int:
    """Replace the operands in a mask by their own masks."""
    result_mask = mask & 1
    while mask := mask & ~1:
        lowest = mask & -mask
        result_mask |= operands[lowest.bit_length() - 2]
        mask ^= lowest
    return result_mask
