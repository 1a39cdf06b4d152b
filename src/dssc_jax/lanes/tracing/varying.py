"""Analysis of a trace, before its translation: which values are *varying*, that is, may differ between lanes.

The builder needs to know which states of a loop vary before it builds the loop's body. The rule is that the results of
an equation vary if an operand does. In loops the rule is applied until nothing changes.
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
    """Return the number of a scan's constants and the number of its states.

    The operands of a scan are its constants, then its initial states, then the arrays whose rows it takes. JAX stores
    the two numbers up to version 0.10; from 0.11 on, it stores the tree of the operands.
    """
    params = equation.params
    if "ft_in" in params:  # the tree
        constants, state, _ = params["ft_in"].update(equation.invars).unpack()
        return len(list(constants)), len(list(state))
    return params["num_consts"], params["num_carry"]


class VaryingResults:
    """Finds out which results of a program vary, given which of its operands vary.

    A *mask* is an integer that tells when a value varies. Bit 0: always; bit i + 1: if operand i of the program varies;
    no bit: never. The mask of a value that depends on several others is the bitwise "or" of their masks.
    """

    def __init__(self) -> None:
        """Begin without masks of any program."""
        self._masks: dict[int, tuple[Jaxpr, list[int]]] = {}

    def of(self, jaxpr: Jaxpr, operands: Sequence[int]) -> list[int]:
        """Return the mask of each result of a jaxpr, given the mask of each operand.

        The masks in terms of the jaxpr's own inputs are computed once and kept, by the jaxpr's id. The jaxpr is stored
        with the masks, so that it stays alive and no other jaxpr gets the same id.
        """
        if id(jaxpr) not in self._masks:
            self._masks[id(jaxpr)] = jaxpr, self._in_terms_of_inputs(jaxpr)
        _, masks = self._masks[id(jaxpr)]
        return [with_operands(mask, operands) for mask in masks]

    def _in_terms_of_inputs(self, jaxpr: Jaxpr) -> list[int]:
        """Return the mask of each result of a jaxpr, in which bit i + 1 stands for the jaxpr's input i."""
        scope: dict[Var, int] = {variable: 1 << (i + 1) for i, variable in enumerate(jaxpr.invars)}

        def read(atoms: Iterable[Any]) -> list[int]:
            """Return the masks of operands or results; 0, which means never, for literals and constants."""
            return [0 if isinstance(atom, Literal) else scope.get(atom, 0) for atom in atoms]

        for equation in jaxpr.eqns:
            scope.update(zip(equation.outvars, self._equation(equation, read(equation.invars)), strict=True))
        return read(jaxpr.outvars)

    def of_while(
        self, head: Jaxpr, body: Jaxpr, operands: Sequence[int], first_body_constant: int, first_state: int
    ) -> tuple[list[int], int]:
        """Return the mask of each state of a while loop, and the mask of the loop's condition.

        If the condition varies, some lanes keep their states while others continue, so all states vary.

        Args:
            head: The loop's condition.
            body: The loop's body.
            operands: Masks of the condition's constants, the body's constants, and the initial states.
            first_body_constant: Position of the body's first constant.
            first_state: Position of the first state.
        """
        head_constants = operands[:first_body_constant]
        body_constants = operands[first_body_constant:first_state]
        state = list(operands[first_state:])
        while True:
            condition = self.of(head, [*head_constants, *state])[0]
            body_masks = self.of(body, [*body_constants, *state])
            next_state = [old | new | condition for old, new in zip(state, body_masks, strict=True)]
            if next_state == state:
                return state, condition
            state = next_state

    def of_scan(self, body: Jaxpr, operands: Sequence[int], first_state: int, first_row: int) -> list[int]:
        """Return the mask of each state of a scan.

        Args:
            body: The scan's body.
            operands: Masks of the constants, the initial states, and the rows.
            first_state: Position of the first state.
            first_row: Position of the first row.
        """
        constants = operands[:first_state]
        state = list(operands[first_state:first_row])
        rows = operands[first_row:]
        while True:
            body_masks = self.of(body, [*constants, *state, *rows])[: len(state)]  # without the stacked outputs
            next_state = [old | new for old, new in zip(state, body_masks, strict=True)]
            if next_state == state:
                return state
            state = next_state

    def _equation(self, equation: JaxprEqn, operands: list[int]) -> list[int]:
        """Return the masks of one equation's results, given the masks of its operands."""
        name = equation.primitive.name
        params = equation.params
        count = len(equation.outvars)
        if name.startswith("pmax"):  # a maximum over the lanes: never
            return [0] * count
        if name == FOREIGN_CALL:  # always
            return [1] * count
        if name == "while":
            first_body_constant = params["cond_nconsts"]
            first_state = first_body_constant + params["body_nconsts"]
            head = params["cond_jaxpr"].jaxpr
            state, _ = self.of_while(head, params["body_jaxpr"].jaxpr, operands, first_body_constant, first_state)
            return state
        if name == "scan":
            first_state, state_count = parts_of_scan(equation)
            state = self.of_scan(params["jaxpr"].jaxpr, operands, first_state, first_state + state_count)
            stacked = [1] * (count - state_count)
            return [*state, *stacked]
        if name == "cond":
            index, *arguments = operands
            masks_of_sides = [self.of(branch.jaxpr, arguments) for branch in params["branches"]]
            return [reduce(or_, masks, index) for masks in zip(*masks_of_sides, strict=True)]
        inner = params.get("jaxpr", params.get("call_jaxpr"))
        if isinstance(inner, ClosedJaxpr | Jaxpr):
            jaxpr = inner.jaxpr if isinstance(inner, ClosedJaxpr) else inner
            if len(jaxpr.invars) == len(operands) and len(jaxpr.outvars) == count:
                return self.of(jaxpr, operands)
        return [reduce(or_, operands, 0)] * count  # if any operand varies


def with_operands(mask: int, operands: Sequence[int]) -> int:
    """Translate the mask of a result from the inputs of an inner program to those of the outer one.

    Args:
        mask: The mask, in which bit i + 1 stands for operand i of the inner program.
        operands: The mask of each operand in the outer program. It takes the place of bit i + 1; bit 0 stays.
    """
    result = mask & 1
    for i, operand_mask in enumerate(operands):
        if mask >> (i + 1) & 1:
            result |= operand_mask
    return result
