"""The text of a program in C, for people: one statement a line, with the names of the model.

It is the second emitter of programs beside :mod:`dssc_jax.lanes.llvm.module_text`. Both keep every operation and its
operands, so a C compiler that neither contracts nor reorders gives the bits of strict machine code. A value gets a
statement of its own if the model names it, if it is needed twice, or if its expression would make a line too long.
"""

import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from dssc_jax.lanes.c.names import is_forbidden, underscored
from dssc_jax.lanes.c.operations import ATOM, UNARY, Expression, Notation, c_literal, c_type
from dssc_jax.lanes.passes.liveness import reachable
from dssc_jax.lanes.program import Branch, CodeBlock, CodeLoop, Program, Subroutine, Value, all_blocks, operands_of
from dssc_jax.lanes.tracing.origins import Origin
from dssc_jax.lanes.unsupported import Unsupported

LONGEST_EXPRESSION = 88
"""Largest number of characters of an expression on a line."""
SHORT_EXPRESSION = 30
"""A negative number of fewer characters is written again wherever it is used, and gets no variable."""
NO_EXPRESSION = Expression("", ATOM)
"""Stands for a loop or branch that is written: only its results have expressions."""


class CText:
    """Writes the statements of a program in C.

    Args:
        program: The program.
        origins: Place in the model where each value is computed, by the value's ``id``.
        inputs: C's expression of each input.
        real: Dtype of the floating-point numbers.
        reserved_names: Names that no variable may have.
        constants: Names of the file's constants, by their value; None: the file has none.
        notation: Collects the functions that operations need; None: a new one.
        prefix: Prefix of the names of tables.

    Attributes:
        lines: The statements so far.
        tables: Definitions of constant tables that the statements read.
        functions: Definitions of subroutines that the statements call, by name.
    """

    def __init__(
        self,
        program: Program,
        origins: Mapping[int, Origin],
        inputs: Sequence[str],
        real: np.dtype,
        reserved_names: Iterable[str] = (),
        constants: Mapping[float, str] | None = None,
        notation: Notation | None = None,
        prefix: str = "",
    ) -> None:
        """Begin without statements."""
        self.program = program
        self.origins = origins
        self.inputs = inputs
        self.constants = constants or {}
        self.notation = notation or Notation(real)
        self.tables: list[str] = []
        self.functions: dict[str, str] = {}
        self._real = real
        self._prefix = prefix
        self.lines: list[str] = []
        self._reserved_names = {*reserved_names}
        self._written: dict[int, Expression] = {}  # by the id of the value
        self._uses = use_counts(program)
        self._function = ""  # of the model, to which the last heading belongs
        self._indent = 1  # steps of four spaces

    # Public methods

    def compute(self, outputs: Sequence[Value]) -> None:
        """Write the statements on which some outputs depend, except the statements that are written already."""
        self._block(self.program.body, reachable(Program(self.program.inputs, self.program.body, list(outputs))))

    def indent(self, steps: int) -> None:
        """Indent the following lines by more steps of four spaces; by fewer if ``steps`` is negative."""
        self._indent += steps

    def line(self, text: str) -> None:
        """Write a line at the present indentation; an empty text gives an empty line."""
        self.lines.append("    " * self._indent + text if text else "")

    def read(self, value: Value) -> str:
        """Return the text of C's expression of a value: a constant, an input, or a value that is written already."""
        return self._expression(value).text

    # Blocks

    def _block(self, block: CodeBlock, alive: set[int]) -> None:
        """Write the nodes of a block, except the nodes that are written already.

        Args:
            block: The block.
            alive: The ``id`` of each node to write; other nodes are left out.
        """
        for node in block.nodes:
            if id(node) not in alive or id(node) in self._written:
                continue
            if isinstance(node, CodeLoop):
                self._loop(node, alive)
            elif isinstance(node, Branch):
                self._branch(node, alive)
            elif isinstance(node, Value) and node.operation not in ("input", "state", "result", "joined"):
                self._value(node)

    def _value(self, value: Value) -> None:
        """Write a statement that assigns a value to a variable, or keep its expression for the values that use it.

        A value gets a statement if the model names it, if its expression is long, or if it is used more than once and
        is not a short negative.
        """
        origin = self.origins.get(id(value), Origin(""))
        expression = self._operation(value)
        is_short_negative = value.operation == "neg" and len(expression.text) < SHORT_EXPRESSION
        is_repeated = self._uses.get(id(value), 0) > 1 and not is_short_negative
        if origin.name or is_repeated or len(expression.text) > LONGEST_EXPRESSION:
            self._heading(origin)
            name = self._variable(origin.name or "part")
            self.line(f"const {c_type(value.dtype)} {name} = {expression.text};")
            expression = Expression(name, ATOM)
        self._written[id(value)] = expression

    def _heading(self, origin: Origin) -> None:
        """Write a comment with the name and summary of the model's function, if it is not that of the last heading."""
        if origin.function and origin.function != self._function:
            self._function = origin.function
            name = origin.function.rpartition(".")[2]
            summary = f": {origin.summary}" if origin.summary else ""
            self.line("")
            for text in comment(f"{name}{summary}"):
                self.line(text)

    def _variable(self, name: str) -> str:
        """Return and reserve a new name of a variable: the wanted name or, if it is taken or invalid, with a number."""
        base = underscored(name) or "part"
        if base[0].isdigit():
            base = f"part_{base}"
        needs_number = base == "part" or is_forbidden(base)
        variable = f"{base}_1" if needs_number else base
        count = 2 if needs_number else 1
        while variable in self._reserved_names:
            variable = f"{base}_{count}"
            count += 1
        self._reserved_names.add(variable)
        return variable

    # Control

    def _loop(self, loop: CodeLoop, alive: set[int]) -> None:
        """Write a loop as ``while``.

        The body computes the next states and the condition for another turn, and then changes all states at once.
        States on which no output depends are left out.

        Args:
            loop: The loop.
            alive: The ``id`` of each node on which an output depends.
        """
        live_positions = []
        for i, (state, result) in enumerate(zip(loop.states, loop.results, strict=True)):
            if id(state) in alive or id(result) in alive:
                live_positions.append(i)
        names = {i: self._variable("state") for i in live_positions}
        for i in live_positions:
            self.line(f"{c_type(loop.states[i].dtype)} {names[i]} = {self.read(loop.initial_states[i])};")
            variable = Expression(names[i], ATOM)
            self._written[id(loop.states[i])] = variable
            self._written[id(loop.results[i])] = variable
        proceed = self._variable("again")
        self.line(f"bool {proceed} = {'true' if loop.guard is None else self.read(loop.guard)};")
        self.line(f"while ({proceed}) {{")
        self.indent(1)
        self._block(loop.body, alive)
        next_names = {i: self._variable("next") for i in live_positions}
        for i in live_positions:
            self.line(f"const {c_type(loop.states[i].dtype)} {next_names[i]} = {self.read(loop.next_states[i])};")
        assert loop.proceed is not None
        self.line(f"{proceed} = {self.read(loop.proceed)};")
        for i in live_positions:
            self.line(f"{names[i]} = {next_names[i]};")
        self.indent(-1)
        self.line("}")
        self._written[id(loop)] = NO_EXPRESSION

    def _branch(self, branch: Branch, alive: set[int]) -> None:
        """Write a branch as ``if`` and ``else``, which assign the results of the branch to variables.

        Args:
            branch: The branch.
            alive: The ``id`` of each node on which an output depends.
        """
        live_positions = [i for i, value in enumerate(branch.results) if id(value) in alive]
        names = {i: self._variable("chosen") for i in live_positions}
        for i in live_positions:
            self.line(f"{c_type(branch.results[i].dtype)} {names[i]};")
            self._written[id(branch.results[i])] = Expression(names[i], ATOM)
        heads = f"if ({self.read(branch.condition)}) {{", "} else {"
        for head, block, values in zip(heads, branch.sides, branch.values, strict=True):
            self.line(head)
            self.indent(1)
            self._block(block, alive)
            for i in live_positions:
                self.line(f"{names[i]} = {self.read(values[i])};")
            self.indent(-1)
        self.line("}")
        self._written[id(branch)] = NO_EXPRESSION

    # Expressions

    def _expression(self, value: Value) -> Expression:
        """Return C's expression of a value: a constant, an input, or a value that is written already."""
        if value.operation == "constant":
            name = self.constants.get(float(value.detail)) if value.dtype.kind == "f" else None
            if name is not None:
                return Expression(name, ATOM)
            text = c_literal(value.detail, value.dtype)
            return Expression(text, UNARY if text.startswith("-") else ATOM)
        if value.operation == "input":
            return Expression(self.inputs[int(value.detail)], ATOM)
        return self._written[id(value)]

    def _operation(self, value: Value) -> Expression:
        """Return C's expression of an operation whose operands are written already."""
        operands = [self._expression(operand) for operand in value.operands]
        if value.operation == "lookup":
            return Expression(self._lookup(value, operands[0].text), ATOM)
        if value.operation == "rarely":
            self._subroutine(value.detail)
        return self.notation.expression(value, operands)

    def _subroutine(self, subroutine: Subroutine) -> None:
        """Write a subroutine as a function with arguments x1, x2, ...; do nothing if it is written already."""
        name = subroutine.name
        program = subroutine.program
        if name in self.functions:
            return
        self._reserved_names.add(name)
        inputs = [f"x{i + 1}" for i in range(len(program.inputs))]
        text = CText(program, {}, inputs, self._real, inputs, notation=self.notation, prefix=f"{name}_")
        result = program.outputs[0]  # its only output
        assert isinstance(result, Value)
        text.compute([result])
        arguments = [f"{c_type(dtype)} {argument}" for dtype, argument in zip(program.inputs, inputs, strict=True)]
        head = f"static {c_type(result.dtype)} {name}({', '.join(arguments)})  /* of an argument that is rare */"
        self.functions[name] = "\n".join([head, "{", *text.lines, f"    return {text.read(result)};", "}"])
        self.tables += text.tables

    def _lookup(self, value: Value, index: str) -> str:
        """Define a constant table, and return C's expression of its element at an index.

        A negative index or one beyond the end gives the last element.

        Args:
            value: The element; its detail is the table.
            index: C's expression of the index.

        Raises:
            Unsupported: The index does not have 32 bits.
        """
        table = value.detail
        index_type = value.operands[0].dtype
        if index_type.itemsize != 4:
            raise Unsupported(f"a table with an index of type {index_type} in C")
        name = f"{self._prefix}table_{len(self.tables) + 1}"
        numbers = ", ".join(c_literal(number, value.dtype) for number in table)
        self.tables.append(f"static const {c_type(value.dtype)} {name}[{table.size}] = {{{numbers}}};")
        end = table.size - 1
        return f"{name}[(uint32_t)({index}) < {end}u ? (uint32_t)({index}) : {end}u]"


def comment(text: str) -> list[str]:
    """Return the lines of a comment in C; characters beyond ASCII become ?, and marks of comments are removed."""
    plain = re.sub(r"\*/|/\*", "", text).encode("ascii", "replace").decode()
    lines = textwrap.wrap(plain, LONGEST_EXPRESSION, break_on_hyphens=False) or [""]
    lines = [f" * {line}" for line in lines]
    lines[0] = f"/*{lines[0].removeprefix(' *')}"
    lines[-1] += " */"
    return lines


def use_counts(program: Program) -> dict[int, int]:
    """Count the uses of each value, by its ``id``, among the nodes on which an output depends.

    Being an output counts as one use. A use in an inner block counts as two, because that block may run more than once.
    """
    alive = reachable(program)
    counts = dict.fromkeys((id(value) for value in program.outputs), 1)
    for block in all_blocks(program.body):
        for node in block.nodes:
            if id(node) in alive:
                for operand in operands_of(node):
                    uses = 1 if operand.block is block else 2
                    counts[id(operand)] = counts.get(id(operand), 0) + uses
    return counts
