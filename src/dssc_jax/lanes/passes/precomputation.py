"""Precomputation of the uniform values of a time loop, for several turns at once, in a vector along time.

All lanes share the time and what follows from it alone, such as the sine of a reference. Computed as scalars in every
turn, such values would cost as much as the same operations on a whole vector of lanes. If the uniform states of a loop
only count, one vector can hold a value for each of the next :data:`TURNS` turns. The vector is stored in a buffer, from
which each turn reads one element.
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
        counters: Growth of each uniform state in a turn, by the state's position; such a state only counts.
        values: The uniform values of the body, in the order of the body.
        outputs: The counters and values that the rest of a turn reads, and that are therefore stored in buffers.
    """

    counters: dict[int, int]
    values: list[Value]
    outputs: list[Value]


def precomputation_plan(loop: CodeLoop, alive: Set[int]) -> PrecomputationPlan | None:
    """Select the uniform values of a loop's body to precompute; None if that is impossible or not worthwhile.

    Precomputation is impossible if the body has a loop, a branch with a uniform result, a value that lanes share by
    ``any``, or a uniform state that does more than count. With fewer than :data:`WORTHWHILE` values it saves no time.

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
    """Return the constant whole number that every turn adds to a state of a loop; 0 if a turn does anything else."""
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

    Element k of a vector is the value in turn k of the next :data:`TURNS` turns, with k = 0 for the first.

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
        """Return a name that is unused among the names of the lanes' instructions."""
        return self.lanes.new_name(prefix)

    def begin(self, label: str) -> None:
        """Begin a basic block with this label; the lines are those of the lanes' instructions."""
        self.lanes.begin(label)

    def current(self) -> str:
        """Return the label of the lanes' present basic block."""
        return self.lanes.current()

    def is_vector(self, value: Value) -> bool:
        """Whether a value is a vector along time: true for every value but a constant."""
        return value.operation != "constant"

    def read(self, value: Value, vector: bool) -> str:
        """Return the register or literal of a value; a value from outside the loop is first repeated in a vector."""
        if value.operation != "constant" and (id(value), True) not in self.names:
            self.names[id(value), True] = self.splat(value.dtype, self.lanes.read(value, False))
        return super().read(value, vector)

    def write(self, loop: CodeLoop) -> None:
        """Write the instructions that compute the values of the next turns from the counters, and that store them."""
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
        """Return the instructions that reserve the buffers, for the start of the function; call after :meth:`write`."""
        lines = []
        for value in self.plan.outputs:
            kind = self.kind(stored_type(value.dtype), True)
            lines.append(f"  {self.buffers[id(value)]} = alloca {kind}, align 64")
        return lines

    def load(self, turn: str) -> None:
        """Write the instructions that read one turn's values from the buffers, as scalars.

        Args:
            turn: Register with the number of the turn, from 0 to TURNS - 1.
        """
        for value in self.plan.outputs:
            dtype = stored_type(value.dtype)
            scalar = scalar_type(dtype)
            place = self.emit(f"getelementptr {scalar}, ptr {self.buffers[id(value)]}, i64 {turn}", "p")
            register = self.emit(f"load {scalar}, ptr {place}")
            if value.dtype == BOOL:
                register = self.emit(f"trunc {scalar} {register} to i1")
            self.lanes.name(value, register)
