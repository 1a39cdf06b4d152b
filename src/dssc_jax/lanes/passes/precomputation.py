"""Precomputation of the uniform values of a time loop, for several turns at once, in a vector along time.

All lanes share the time and what follows from it alone, such as the sine of a reference. As scalars in every turn, such
values would cost as much as those of a whole vector of lanes. If the uniform states of a loop only count, a vector can
hold the values of the next :data:`TURNS` turns. They are stored in a buffer, from which each turn reads its own.
"""

from collections.abc import Set
from dataclasses import dataclass

from dssc_jax.lanes.interface import stored_type
from dssc_jax.lanes.llvm.function_text import scalar_type
from dssc_jax.lanes.llvm.instructions import Instructions
from dssc_jax.lanes.passes.scheduling import schedule
from dssc_jax.lanes.program import BOOL, Branch, CodeLoop, Value, all_blocks, operands_of

TURNS = 8  # of the loop, for which values are computed at once
WORTHWHILE = 12  # uniform operations in a turn from which on precomputation saves time


@dataclass(frozen=True)
class PrecomputationPlan:
    """The values of a loop to precompute.

    Args:
        counters: Growth of each uniform state in a turn, by the state's position. Such a state only counts.
        values: The uniform values of the body, in order.
        outputs: The counters and values that a turn reads, and that are therefore stored.
    """

    counters: dict[int, int]
    values: list[Value]
    outputs: list[Value]


def precomputation_plan(loop: CodeLoop, alive: Set[int]) -> PrecomputationPlan | None:
    """Select the uniform values of a loop's body to precompute; None if that is impossible or not worthwhile.

    It is impossible if the body has a loop, a branch with a uniform result, a value that lanes share by ``any``, or a
    uniform state that does more than count.

    Args:
        loop: The loop.
        alive: Ids of the values that the program's results depend on.
    """
    body_nodes = [node for block in all_blocks(loop.body) for node in block.nodes]
    nodes = [node for node in body_nodes if id(node) in alive]
    if any(isinstance(node, CodeLoop) for node in nodes):
        return None
    if any(not value.varying for node in nodes if isinstance(node, Branch) for value in node.results):
        return None
    values = [node for node in loop.body.nodes if isinstance(node, Value) and not node.varying and id(node) in alive]
    if len(values) < WORTHWHILE or any(value.operation == "any" for value in values):
        return None
    states = [i for i, state in enumerate(loop.states) if id(state) in alive or id(loop.results[i]) in alive]
    counters = {i: growth_in_turn(loop, i) for i in states if not loop.states[i].varying}
    if any(growth == 0 for growth in counters.values()):
        return None
    planned_ids = {id(value) for value in values}
    read_ids = {id(operand) for node in nodes if id(node) not in planned_ids for operand in operands_of(node)}
    read_ids |= {id(loop.proceed), *(id(loop.next_states[i]) for i in states)}
    candidates = [*(loop.states[i] for i in counters), *values]
    outputs = [value for value in candidates if id(value) in read_ids]
    return PrecomputationPlan(counters, values, outputs)


def growth_in_turn(loop: CodeLoop, position: int) -> int:
    """The constant whole number by which a state of a loop grows in every turn; 0 if it does anything else."""
    state = loop.states[position]
    next_value = loop.next_states[position]
    if next_value.operation != "add" or next_value.dtype.kind not in "iu":
        return 0
    first, second = next_value.operands
    if first is state and second.operation == "constant":
        return int(second.detail)
    if second is state and first.operation == "constant":
        return int(first.detail)
    return 0


class Precomputation(Instructions):
    """Writes the instructions that precompute uniform values, as vectors along time.

    A vector has the value of the next turn first, and of the turn after it second.

    Args:
        lanes: The instructions of the lanes, to which these are added.
        plan: The values to precompute.
        window: See :func:`~dssc_jax.lanes.passes.scheduling.schedule`.
    """

    def __init__(self, lanes: Instructions, plan: PrecomputationPlan, window: int) -> None:
        """Share lines, tables, declarations and subroutines with the lanes' instructions, but not registers."""
        super().__init__(
            TURNS,
            lanes.flags,
            lanes.register_use._replace(piece_width=0),
            lines=lanes.lines,
            tables=lanes.tables,
            declarations=lanes.declarations,
            subroutines=lanes.subroutines,
        )
        self.lanes = lanes
        self.plan = plan
        self.window = window
        self.buffers: dict[int, str] = {}  # register with the address of the stored vector, by the value's id

    def new_name(self, prefix: str = "v") -> str:
        """A new name among those of the lanes."""
        return self.lanes.new_name(prefix)

    def begin(self, label: str) -> None:
        """Begin a basic block of the lanes."""
        self.lanes.begin(label)

    def current(self) -> str:
        """The label of the basic block of the lanes."""
        return self.lanes.current()

    def is_vector(self, value: Value) -> bool:
        """Whether a value is a vector along time, as every value but a constant is."""
        return value.operation != "constant"

    def read(self, value: Value, vector: bool) -> str:
        """The register or literal of a value; a value from before the loop is repeated in a vector."""
        if value.operation != "constant" and (id(value), True) not in self.names:
            self.names[id(value), True] = self.splat(value.dtype, self.lanes.read(value, False))
        return super().read(value, vector)

    def write(self, loop: CodeLoop) -> None:
        """Write the computation of the values of the next turns from the present counters, and their storing."""
        for position, growth in self.plan.counters.items():
            state = loop.states[position]
            scalar = scalar_type(state.dtype)
            offsets = ", ".join(f"{scalar} {growth * turn}" for turn in range(TURNS))
            start = self.splat(state.dtype, self.lanes.read(state, False))
            self.names[id(state), True] = self.emit(f"add {self.kind(state.dtype, True)} {start}, <{offsets}>")
        for value in schedule(self.plan.values, self.window):
            assert isinstance(value, Value)
            self.name(value, self.value(value))
        for value in self.plan.outputs:
            register = self.names[id(value), True]
            dtype = stored_type(value.dtype)
            if value.dtype == BOOL:
                register = self.emit(f"zext {self.kind(BOOL, True)} {register} to {self.kind(dtype, True)}")
            buffer = self.buffers[id(value)] = f"%{self.new_name('ahead')}"
            self.lines.append(f"  store {self.kind(dtype, True)} {register}, ptr {buffer}, align 64")

    def allocations(self) -> list[str]:
        """The instructions that reserve the buffers, for the start of the function."""
        lines = []
        for value in self.plan.outputs:
            kind = self.kind(stored_type(value.dtype), True)
            lines.append(f"  {self.buffers[id(value)]} = alloca {kind}, align 64")
        return lines

    def load(self, turn: str) -> None:
        """Write the reading of one turn's values as scalars; ``turn`` is the register with the turn's number."""
        for value in self.plan.outputs:
            dtype = stored_type(value.dtype)
            scalar = scalar_type(dtype)
            place = self.emit(f"getelementptr {scalar}, ptr {self.buffers[id(value)]}, i64 {turn}", "p")
            register = self.emit(f"load {scalar}, ptr {place}")
            if value.dtype == BOOL:
                register = self.emit(f"trunc {scalar} {register} to i1")
            self.lanes.name(value, register)
