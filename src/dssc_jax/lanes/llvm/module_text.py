"""The text for LLVM of a lane's program: one function that runs all lanes of a range, a vector of lanes at a time.

Fast arithmetic allows a product and a sum to be contracted, with one rounding, and ignores the sign of zero. It assumes
nothing else; in particular, a NaN is a possible result. Strict arithmetic allows neither.
"""

from collections.abc import Sequence, Set

import numpy as np

from dssc_jax.lanes.foreign import ALIGNMENT, ForeignFunction, MemoryPlace
from dssc_jax.lanes.interface import ENTRY_POINT, stored_type
from dssc_jax.lanes.llvm import foreign_calls
from dssc_jax.lanes.llvm.function_text import FAST, MANY_REGISTERS, STRICT, RegisterUse, scalar_type
from dssc_jax.lanes.llvm.instructions import Instructions
from dssc_jax.lanes.operations import Operation
from dssc_jax.lanes.passes.liveness import reachable
from dssc_jax.lanes.passes.observation import observing_nodes, placed_early
from dssc_jax.lanes.passes.precomputation import TURNS, Precomputation, PrecomputationPlan, precomputation_plan
from dssc_jax.lanes.passes.scheduling import schedule
from dssc_jax.lanes.program import BOOL, Branch, CodeBlock, CodeLoop, Node, Program, Record, Recording, Value

WIDE = '"prefer-vector-width"="512" "min-legal-vector-width"="512"'
"""LLVM's attributes of a function that may use the widest vectors."""
COLD = "#1"  # attributes of a function that is seldom called; see ATTRIBUTES
ATTRIBUTES = (
    f'attributes #0 = {{ nounwind {WIDE} "stackrealign" }}',  # spilled vectors within lines of the cache
    f'attributes #1 = {{ nounwind noinline cold {WIDE} "stackrealign" }}',
    'attributes #2 = { nounwind noinline "stackrealign" }',  # of calls of C
    '!0 = !{!"branch_weights", i32 1, i32 1000000}',  # of what happens rarely
    "!llvm.module.flags = !{!1}",
    '!1 = !{i32 7, !"RtLibUseGOT", i32 1}',  # calls of C need no code beside, for which there would be no memory
)


class Emitter(Instructions):
    """Writes the module of a program.

    Args:
        program: The program.
        width: Number of lanes in a vector.
        strict: Whether products and sums are never contracted.
        window: See :func:`~dssc_jax.lanes.passes.scheduling.schedule`.
        register_use: How the function spares registers.
    """

    def __init__(self, program: Program, width: int, strict: bool, window: int, register_use: RegisterUse) -> None:
        """Begin without lines, and find the nodes on which a result depends."""
        super().__init__(width, STRICT if strict else FAST, register_use)
        self.program = program
        self.window = window
        self.strict = strict
        self.alive = reachable(program)  # ids of nodes
        self.parts: dict[int, list[str]] = {}  # registers of the results of a call of C, by the id of the call
        self.called_functions: dict[str, ForeignFunction] = {}  # by symbol
        self.computed_ids: set[int] = set()  # of values that are precomputed

    def text(self) -> str:
        """Write the text of the module."""
        self.lines += self.opening()
        self.label = "lanes"
        self.block(self.program.body)
        self.lines += ["  br label %store", "store:"]
        for position, output in enumerate(self.program.outputs):
            if isinstance(output, Value):
                self.store(position, output)
        self.lines += self.closing()
        functions = self.functions()
        head_lines = [*self.tables, *sorted(self.declarations), self.head(), "entry:", *self.allocated]
        return "\n".join([*head_lines, *self.lines, "}", *functions, *ATTRIBUTES, ""])

    def head(self) -> str:
        """Return the first line of the function, which runs the lanes from ``first`` to just before ``last``."""
        return f"define void @{ENTRY_POINT}(ptr noalias %inputs, ptr noalias %outputs, i64 %first, i64 %last) #0 {{"

    def opening(self) -> list[str]:
        """Return the lines before the first instruction of a vector of lanes."""
        return [
            "  %some = icmp ult i64 %first, %last",
            "  br i1 %some, label %lanes, label %done",
            "lanes:",
            "  %lane = phi i64 [ %first, %entry ], [ %next, %store ]",
        ]

    def closing(self) -> list[str]:
        """Return the lines after the last store of a vector of lanes."""
        return [
            f"  %next = add i64 %lane, {self.width}",
            "  %more = icmp ult i64 %next, %last",
            "  br i1 %more, label %lanes, label %done",
            "done:",
            "  ret void",
        ]

    def functions(self) -> list[str]:
        """Return the definitions of the subroutines that are called, and of the functions that call functions of C."""
        lines: list[str] = []
        for name, (subroutine, width) in self.subroutines.items():
            emitter = SubroutineEmitter(subroutine.program, width, self.strict, 0, MANY_REGISTERS)
            emitter.tables = self.tables
            emitter.declarations = self.declarations
            lines += emitter.definition(name)
        for function in self.called_functions.values():
            lines += foreign_calls.definition(function, self.width)
        return lines

    # Blocks

    def block(self, block: CodeBlock, early: Set[int] = frozenset()) -> None:
        """Write the nodes of a block on which a result depends, in scheduled order; ``early``: see placed_early."""
        order = schedule([node for node in block.nodes if self.is_needed(node)], self.window)
        for node in placed_early(order, early):
            if isinstance(node, Record):
                self.record(node)
            elif isinstance(node, Value):
                self.compute(node)
            elif isinstance(node, CodeLoop):
                self.loop(node)
            else:
                self.branch(node)

    def is_needed(self, node: Node) -> bool:
        """Whether a node must be written: a result depends on it, and it is not precomputed."""
        return id(node) in self.alive and id(node) not in self.computed_ids

    def loop(self, loop: CodeLoop) -> None:
        """Write a loop that tests its condition after each turn; precompute uniform values where that saves time."""
        top = self.new_name("loop")
        end = self.new_name("end")
        entry = self.label
        needed = self.needed_states(loop)
        plan = precomputation_plan(loop, self.alive) if self.width > 1 else None
        if loop.guard is None:
            self.lines.append(f"  br label %{top}")
        else:
            self.lines.append(f"  br i1 {self.read(loop.guard, False)}, label %{top}, label %{end}")
        self.begin(top)
        phi_lines = self.reserve_phis([loop.states[i] for i in needed])
        proceed = self.turns(loop, plan, needed) if plan else self.turn(loop)
        self.lines.append(f"  br i1 {proceed}, label %{top}, label %{end}")
        turn_end = self.label  # the block from which the loop turns again or ends
        for phi_line, i in zip(phi_lines, needed, strict=True):
            self.fill(phi_line, loop.states[i], (loop.initial_states[i], entry), (loop.next_states[i], turn_end))
        self.begin(end)
        registers = {}
        for i in needed:
            wide = loop.states[i].varying
            sources = f"[ {self.read(loop.next_states[i], wide)}, %{turn_end} ]"
            if loop.guard is not None:  # the loop may be left out
                sources = f"[ {self.read(loop.initial_states[i], wide)}, %{entry} ], {sources}"
            registers[i] = self.emit(f"phi {self.kind(loop.results[i].dtype, wide)} {sources}")
        for i in needed:
            self.name(loop.results[i], registers[i])

    def needed_states(self, loop: CodeLoop) -> list[int]:
        """Return the positions of a loop's states on which a result of the program depends, in or after the loop."""
        positions = []
        for i, (state, result) in enumerate(zip(loop.states, loop.results, strict=True)):
            if id(state) in self.alive or id(result) in self.alive:
                positions.append(i)
        return positions

    def turn(self, loop: CodeLoop) -> str:
        """Write one turn of a loop, its body; return the register of the condition for another turn."""
        self.block(loop.body, observing_nodes(loop) if self.register_use.piece_width else frozenset())
        assert loop.proceed is not None
        return self.read(loop.proceed, False)

    def turns(self, loop: CodeLoop, plan: PrecomputationPlan, needed: Sequence[int]) -> str:
        """Write several turns of a loop as an inner loop, before which uniform values are computed for all of them.

        Args:
            loop: The loop.
            plan: The values to precompute.
            needed: Positions of the needed states, from :meth:`needed_states`.

        Returns:
            The register of the condition for another turn after the inner loop.
        """
        inner = self.new_name("turn")
        out = self.new_name("out")
        precomputation = Precomputation(self, plan, self.window)
        precomputation.write(loop)
        entry = self.label
        self.allocated += precomputation.allocations()
        self.computed_ids |= {id(value) for value in plan.values}
        varying = [i for i in needed if i not in plan.counters]
        first_states = {i: self.read(loop.states[i], True) for i in varying}
        self.lines.append(f"  br label %{inner}")
        self.begin(inner)
        turn_number = f"%{self.new_name('t')}"
        next_turn_number = f"%{self.new_name('t')}"
        turn_line = len(self.lines)
        self.lines.append("")  # for the phi of the turn's number
        state_lines = self.reserve_phis([loop.states[i] for i in varying])
        precomputation.load(turn_number)
        proceed = self.turn(loop)
        self.lines.append(f"  {next_turn_number} = add i64 {turn_number}, 1")
        has_turn_left = self.emit(f"icmp ult i64 {next_turn_number}, {TURNS}")
        proceeds_within = self.emit(f"and i1 {has_turn_left}, {proceed}")
        self.lines.append(f"  br i1 {proceeds_within}, label %{inner}, label %{out}")
        self.lines[turn_line] = f"  {turn_number} = phi i64 [ 0, %{entry} ], [ {next_turn_number}, %{self.label} ]"
        for state_line, i in zip(state_lines, varying, strict=True):
            self.fill(state_line, loop.states[i], (first_states[i], entry), (loop.next_states[i], self.label))
        self.begin(out)
        return proceed

    def reserve_phis(self, states: Sequence[Value]) -> list[int]:
        """Reserve a line for the phi of each state at the top of a loop; return the lines' positions.

        A phi chooses a state's source by the block that ran before. :meth:`fill` writes the lines when all sources are
        known. Until then, a line holds the state's register.
        """
        start = len(self.lines)
        names = [f"%{self.new_name('x')}" for _ in states]
        self.lines += names
        for state, name in zip(states, names, strict=True):
            self.name(state, name)
        return list(range(start, start + len(states)))

    def fill(self, line: int, state: Value, *sources: tuple[Value | str, str]) -> None:
        """Write the phi of a state into its reserved line.

        Args:
            line: Position of the line.
            state: The state.
            sources: The values or registers from which it comes, each with the label of the preceding block.
        """
        wide = state.varying
        texts = []
        for source, label in sources:
            register = source if isinstance(source, str) else self.read(source, wide)
            texts.append(f"[ {register}, %{label} ]")
        state_register = self.lines[line]
        self.lines[line] = f"  {state_register} = phi {self.kind(state.dtype, wide)} {', '.join(texts)}"

    def branch(self, branch: Branch) -> None:
        """Write both sides of a branch, one after the other; the machine skips a side that no lane takes."""
        needed = {i: result for i, result in enumerate(branch.results) if id(result) in self.alive}
        has_mask = self.is_vector(branch.condition)
        condition = self.read(branch.condition, has_mask)
        registers_of_sides = []
        for is_second, block, values in zip((False, True), branch.sides, branch.values, strict=True):
            side_values = {i: (values[i], result.varying) for i, result in needed.items()}
            if any(id(node) in self.alive for node in block.nodes):
                mask = self.invert(condition, has_mask) if is_second else condition
                is_taken = self.any_lane(mask) if has_mask else mask
                registers_of_sides.append(self.side(is_taken, block, side_values))
            else:  # all its values are known before the branch
                registers_of_sides.append({i: self.read(value, wide) for i, (value, wide) in side_values.items()})
        first, second = registers_of_sides
        for i, result in needed.items():
            kind = self.kind(result.dtype, result.varying)
            selector = f"{self.kind(BOOL, has_mask)} {condition}"
            self.name(result, self.emit(f"select {selector}, {kind} {first[i]}, {kind} {second[i]}"))

    def value(self, value: Value) -> str:
        """Write the instructions of one value, calls of functions of C included; return its register."""
        match value.operation:
            case Operation.FOREIGN:
                return self.foreign(value.detail, value)
            case Operation.PART:
                return self.parts[id(value.operands[0])][value.detail]
        return super().value(value)

    def foreign(self, function: ForeignFunction, value: Value) -> str:
        """Write the call ``value`` of a function of C for each lane; return the register of the first result."""
        self.called_functions[function.symbol] = function
        self.declarations.add(f"declare void @{function.symbol}(ptr) nonlazybind")
        self.declarations.add("declare void @llvm.memset.p0.i64(ptr, i8, i64, i1)")
        operand_buffer = self.buffer(function.operands)
        result_buffer = self.buffer(function.results)
        operands = foreign_calls.columns(function.operands, self.width)
        for operand, (_, offset) in zip(value.operands, operands, strict=True):
            self.store_in_buffer(operand_buffer, offset, operand)
        over_lanes = foreign_calls.over_lanes(function, self.width)
        self.lines.append(f"  call void @{over_lanes}(ptr {operand_buffer}, ptr {result_buffer})")
        results = foreign_calls.columns(function.results, self.width)
        self.parts[id(value)] = [self.load_from_buffer(result_buffer, offset, place.dtype) for place, offset in results]
        return self.parts[id(value)][0]

    def buffer(self, places: tuple[MemoryPlace, ...]) -> str:
        """Reserve memory for the vectors of some numbers at the start of the function; return the address register."""
        name = f"%{self.new_name('buffer')}"
        size = foreign_calls.buffer_bytes(places, self.width)
        self.allocated.append(f"  {name} = alloca [{size} x i8], align {ALIGNMENT}")
        return name

    def store_in_buffer(self, buffer: str, offset: int, value: Value) -> None:
        """Write the instructions that store a value of each lane at an offset of a buffer [bytes]."""
        place = self.emit(f"getelementptr i8, ptr {buffer}, i64 {offset}", prefix="p")
        self.emit_store(place, "0", value, True)

    def load_from_buffer(self, buffer: str, offset: int, dtype: np.dtype) -> str:
        """Write the instructions that load a value of each lane from an offset of a buffer [bytes]; return the name."""
        place = self.emit(f"getelementptr i8, ptr {buffer}, i64 {offset}", prefix="p")
        return self.emit(f"load {self.kind(dtype, True)}, ptr {place}, align {dtype.itemsize}")

    def invert(self, condition: str, wide: bool) -> str:
        """Write the negation of a condition; return its register."""
        return self.emit(f"xor {self.kind(BOOL, wide)} {condition}, {'splat (i1 true)' if wide else 'true'}")

    def side(self, is_taken: str, block: CodeBlock, values: dict[int, tuple[Value, bool]]) -> dict[int, str]:
        """Write one side of a branch.

        Args:
            is_taken: Register of the truth value whether any lane takes the side.
            block: The block of the side.
            values: For each position of a result, the side's value and whether it is a vector.

        Returns:
            The register of each result, by position; it holds zeros if no lane takes the side.
        """
        side_label = self.new_name("side")
        end = self.new_name("end")
        entry = self.label
        self.lines.append(f"  br i1 {is_taken}, label %{side_label}, label %{end}")
        self.begin(side_label)
        self.block(block)
        reads = {i: self.read(value, wide) for i, (value, wide) in values.items()}
        final = self.label
        self.lines.append(f"  br label %{end}")
        self.begin(end)
        registers = {}
        for i, (value, wide) in values.items():
            kind = self.kind(value.dtype, wide)
            registers[i] = self.emit(f"phi {kind} [ zeroinitializer, %{entry} ], [ {reads[i]}, %{final} ]")
        return registers

    # Memory

    def store(self, position: int, output: Value) -> None:
        """Write the instructions that store a result of each lane in the column of the output at a position."""
        self.emit_store(self.column("outputs", position), "%lane", output, True)

    def emit_store(self, column: str, element: str, value: Value, wide: bool) -> None:
        """Emit the instructions that store a value in a column; booleans are stored as bytes.

        Args:
            column: Register with the address of the column.
            element: Register or literal with the position of the element.
            value: The value.
            wide: Whether to store the values of all lanes, one after another, with the first at ``element``.
        """
        register = self.read(value, wide)
        dtype = value.dtype
        if dtype == BOOL:
            kind = self.kind(BOOL, wide)
            dtype = stored_type(BOOL)
            register = self.emit(f"zext {kind} {register} to {self.kind(dtype, wide)}")
        place = self.emit(f"getelementptr {scalar_type(dtype)}, ptr {column}, i64 {element}", prefix="p")
        self.lines.append(f"  store {self.kind(dtype, wide)} {register}, ptr {place}, align {dtype.itemsize}")

    def record(self, record: Record) -> None:
        """Write the instructions that store one element of a recording for each lane of the vector, side by side."""
        index = self.emit(f"zext i32 {self.read(record.position, False)} to i64")
        element = self.recorded_element(record.recording, index)
        for position, output in enumerate(self.program.outputs):
            if output is record.recording:
                self.emit_store(self.column("outputs", position), element, record.value, True)

    def recorded_element(self, recording: Recording, index: str) -> str:
        """Write where the element at an index of a recording lies for the vector's first lane; return its register.

        A vector of lanes has the elements of index 0 of all its lanes, then the elements of index 1, and so on.

        Args:
            recording: The recording.
            index: Register of the index, an integer of 64 bits.
        """
        start = self.emit(f"mul i64 %lane, {recording.length}")
        offset = self.emit(f"mul i64 {index}, {self.width}")
        return self.emit(f"add i64 {start}, {offset}")


class SubroutineEmitter(Emitter):
    """Writes a subroutine as a function of LLVM; its arguments are the inputs of its program, vectors of lanes."""

    def input(self, value: Value, wide: bool) -> str:
        """Return the register of the argument that is this input; arguments are vectors, so ``wide`` has no effect."""
        position = value.detail
        return f"%a{position}"

    def definition(self, name: str) -> list[str]:
        """Return the lines of the function, which has the arguments %a0, %a1, ... and returns the only output."""
        result = self.program.outputs[0]
        assert isinstance(result, Value)
        self.block(self.program.body)
        kind = self.kind(result.dtype, True)
        parameters = ", ".join(f"{self.kind(dtype, True)} %a{i}" for i, dtype in enumerate(self.program.inputs))
        head = f"define internal {kind} @{name}({parameters}) {COLD} {{"
        return [head, "entry:", *self.lines, f"  ret {kind} {self.read(result, True)}", "}"]


def module_text(
    program: Program, width: int, strict: bool = False, window: int = 0, register_use: RegisterUse = MANY_REGISTERS
) -> str:
    """Return the text for LLVM of a program's module; the arguments are those of :class:`Emitter`."""
    return Emitter(program, width, strict, window, register_use).text()
