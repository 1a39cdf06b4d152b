"""Which values of a traced program may differ between lanes, before it is translated.

A loop needs to know it of its state before its body is built. A flag spreads from the operands of an equation to its
results, through loops until nothing changes.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal, Var


def is_key(aval: Any) -> bool:
    """Whether values of this type are random keys."""
    return jnp.issubdtype(aval.dtype, jax.dtypes.prng_key)


def parts_of_scan(equation: JaxprEqn) -> tuple[int, int]:
    """How many operands of a scan are constants, and how many are its state.

    JAX stores these two numbers up to version 0.10; from 0.11 on, it stores the tree of the operands.
    """
    params = equation.params
    if "ft_in" in params:
        constants, state, _ = params["ft_in"].update(equation.invars).unpack()
        return len(list(constants)), len(list(state))
    return params["num_consts"], params["num_carry"]


class VaryingResults:
    """Flags of a program's results, remembered by program and flags of its operands."""

    def __init__(self) -> None:
        self._known: dict[tuple[int, tuple[bool, ...]], tuple[Jaxpr, list[bool]]] = {}

    def of(self, jaxpr: Jaxpr, operands: Sequence[bool]) -> list[bool]:
        """Whether each result varies, from whether each operand does."""
        key = id(jaxpr), tuple(operands)
        if key not in self._known:
            scope: dict[Var, bool] = dict(zip(jaxpr.invars, operands, strict=True))

            def read(atoms: Iterable[Any]) -> list[bool]:
                return [not isinstance(atom, Literal) and scope.get(atom, False) for atom in atoms]

            for equation in jaxpr.eqns:
                scope.update(zip(equation.outvars, self._equation(equation, read(equation.invars)), strict=True))
            self._known[key] = jaxpr, read(jaxpr.outvars)
        return self._known[key][1]

    def of_while(
        self, head: Jaxpr, body: Jaxpr, operands: Sequence[bool], first: int, second: int
    ) -> tuple[list[bool], bool]:
        """Whether each part of a while loop's state varies, and whether its condition does."""
        head_constants, constants, state = operands[:first], operands[first:second], list(operands[second:])
        while True:
            condition = self.of(head, [*head_constants, *state])[0]
            after = [
                old or new or condition for old, new in zip(state, self.of(body, [*constants, *state]), strict=True)
            ]
            if after == state:
                return state, condition
            state = after

    def of_scan(self, body: Jaxpr, operands: Sequence[bool], first: int, second: int) -> list[bool]:
        """Whether each part of a scan's state varies."""
        constants, state, rows = operands[:first], list(operands[first:second]), operands[second:]
        while True:
            after = self.of(body, [*constants, *state, *rows])
            after = [old or new for old, new in zip(state, after, strict=False)]
            if after == state:
                return state
            state = after

    def _equation(self, equation: JaxprEqn, operands: list[bool]) -> list[bool]:
        """Flags of one equation's results."""
        name, params = equation.primitive.name, equation.params
        count = len(equation.outvars)
        if name.startswith("pmax"):
            return [False] * count
        if name == "while":
            first, second = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]
            return self.of_while(params["cond_jaxpr"].jaxpr, params["body_jaxpr"].jaxpr, operands, first, second)[0]
        if name == "scan":
            constants, carried = parts_of_scan(equation)
            state = self.of_scan(params["jaxpr"].jaxpr, operands, constants, constants + carried)
            return [*state, *[True] * (count - len(state))]
        if name == "cond":
            which, rest = operands[0], operands[1:]
            sides = [self.of(branch.jaxpr, rest) for branch in params["branches"]]
            return [which or any(flags) for flags in zip(*sides, strict=True)]
        inner = params.get("jaxpr", params.get("call_jaxpr"))
        if isinstance(inner, ClosedJaxpr | Jaxpr):
            jaxpr = inner.jaxpr if isinstance(inner, ClosedJaxpr) else inner
            if len(jaxpr.invars) == len(operands) and len(jaxpr.outvars) == count:
                return self.of(jaxpr, operands)
        return [any(operands)] * count
