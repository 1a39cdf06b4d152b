"""LLVM's instructions for the single values of a program."""

from collections.abc import Sequence

import numpy as np

from dssc_jax.lanes.interface import stored_type
from dssc_jax.lanes.llvm.function_text import STRICT, FunctionText, literal, scalar_type
from dssc_jax.lanes.operations import COMPARISONS, Operation
from dssc_jax.lanes.passes.signs import is_unsigned
from dssc_jax.lanes.program import BOOL, Slot, Value

FLOATS = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv", "rem": "frem"}
"""LLVM's instruction of an operation of floating-point numbers."""
CALLED = {"sqrt": "sqrt", "floor": "floor", "ceil": "ceil", "round": "roundeven", "trunc": "trunc", "abs": "fabs"}
"""LLVM's function of an operation of a floating-point number."""
FLOAT_COMPARISONS = {"eq": "oeq", "ne": "une", "lt": "olt", "le": "ole", "gt": "ogt", "ge": "oge"}
"""LLVM's predicate of a comparison of floating-point numbers; with NaN, only "une" holds."""
INTEGERS = {"add": "add", "sub": "sub", "mul": "mul", "and": "and", "or": "or", "xor": "xor", "shl": "shl"}
"""LLVM's instruction of an operation of integers, signed or not."""
SIGNED = {"div": "sdiv", "rem": "srem", "shr": "ashr"}
UNSIGNED = {"div": "udiv", "rem": "urem", "shr": "lshr"}
"""LLVM's instructions of operations that differ between signed and unsigned integers."""
WHOLE = {
    *(Operation.INPUT, Operation.ANY, Operation.LOOKUP, Operation.RARELY, Operation.FOREIGN, Operation.PART),
    *(Operation.MEMORY, Operation.READ, Operation.WRITE),
}
"""Operations that are written for a whole vector of lanes at once, never for each of its pieces."""


class Instructions(FunctionText):
    """Writes LLVM's instructions for values, and stores the register of each value."""

    def compute(self, value: Value) -> None:
        """Write the instructions of one value, and store its register.

        If the processor has few registers, a vector is written piece by piece; see :class:`RegisterUse`.
        """
        piece_width = self.register_use.piece_width
        if not piece_width or not self.is_vector(value) or value.operation in WHOLE:
            self.name(value, self.value(value))
            return
        whole_width = self.width
        self.width = piece_width
        registers = []
        for piece in range(whole_width // piece_width):
            self.piece = piece
            registers.append(self.value(value))
        self.piece = None
        self.width = whole_width
        self.pieces[id(value)] = registers
        self.names[id(value), True] = self.joined(value.dtype, registers)

    def any_lane(self, mask: str) -> str:
        """Write the test whether a truth value is true in any lane of a vector; return the register of the result.

        Args:
            mask: Register of the vector of truth values.
        """
        kind = self.kind(BOOL, True)
        return self.call(f"llvm.vector.reduce.or.v{self.width}i1", "i1", (kind, mask))

    def value(self, value: Value) -> str:
        """Write the instructions of one value; return the value's register.

        Args:
            value: The value, whose operands are written already.
        """
        operation = value.operation
        dtype = value.dtype
        wide = self.is_vector(value)
        kind = self.kind(dtype, wide)
        if operation == "input":
            return self.input(value, wide)
        if operation == "any":
            mask = value.operands[0]
            return self.any_lane(self.read(mask, True)) if self.is_vector(mask) else self.read(mask, False)
        if operation == "lookup":
            return self.lookup(value, wide)
        if operation == "rarely":
            return self.rarely(value, wide)
        if operation in ("memory", "read", "write"):
            return self.access(value)
        if operation == "select":
            condition, *cases = value.operands
            # of a uniform condition LLVM makes a branch, and orders what comes before and after it separately
            has_mask = self.is_vector(condition) or (wide and self.register_use.piece_width > 0)
            if_true, if_false = (self.operand(case, wide) for case in cases)
            selector = f"{self.kind(BOOL, has_mask)} {self.read(condition, has_mask)}"
            return self.emit(f"select {selector}, {kind} {if_true}, {kind} {if_false}")
        names = [self.operand(operand, wide) for operand in value.operands]
        source = value.operands[0].dtype
        if operation in COMPARISONS:
            return self.compare(operation, source, wide, names)
        if operation in ("convert", "bitcast"):
            return self.convert(operation, source, dtype, wide, names[0])
        if operation in ("max", "min"):
            return self.extreme(operation, value, wide, names)
        return self.arithmetic(operation, dtype, wide, names)

    def input(self, value: Value, wide: bool) -> str:
        """Write the instructions that load an input; return its register.

        Args:
            value: The input; its detail is the position among the inputs.
            wide: Whether to load the elements of a whole vector of lanes.
        """
        column = self.column("inputs", value.detail)
        dtype = stored_type(value.dtype)
        place = self.emit(f"getelementptr {scalar_type(dtype)}, ptr {column}, i64 %lane")
        loaded_register = self.emit(f"load {self.kind(dtype, wide)}, ptr {place}, align {dtype.itemsize}")
        return self.from_stored(value.dtype, wide, loaded_register)

    def from_stored(self, dtype: np.dtype, wide: bool, register: str) -> str:
        """Return the register of a loaded value in its own type; memory holds a truth value as a byte.

        Args:
            dtype: Dtype of the value. For a truth value, a comparison of the byte with 0 is written.
            wide: Whether the value is a vector of lanes.
            register: Register of the loaded value.
        """
        if dtype != BOOL:
            return register
        byte = stored_type(BOOL)
        return self.compare("ne", byte, wide, [register, self.zero(byte, wide)])

    def access(self, value: Value) -> str:
        """Write a ``memory``, ``read`` or ``write`` of a slot; return the register of the result.

        A ``read`` returns the element. The other two return a token, which only orders the accesses. No instruction
        reads it, so its number is 0.
        """
        slot: Slot = value.detail
        token = self.zero(value.dtype, self.width > 1)
        if value.operation == "memory":
            self.reserve(slot)
            return token
        _, index, *written_and_reads = value.operands  # a read has only a token and the index
        kind = self.kind(slot.dtype, True)
        place = self.emit(f"getelementptr {kind}, ptr {self.slots[id(slot)]}, i32 {self.read(index, False)}", "p")
        aligned = f"align {slot.dtype.itemsize}"
        if value.operation == "read":
            return self.emit(f"load {kind}, ptr {place}, {aligned}")
        self.lines.append(f"  store {kind} {self.read(written_and_reads[0], True)}, ptr {place}, {aligned}")
        return token

    def reserve(self, slot: Slot) -> None:
        """Reserve the memory of a slot at the start of the function, and write the instruction that clears it here."""
        place = self.slots[id(slot)] = f"%{self.new_name('slot')}"
        self.allocated.append(f"  {place} = alloca [{slot.length} x {self.kind(slot.dtype, True)}], align 64")
        function = "llvm.memset.p0.i64"
        self.declarations.add(f"declare void @{function}(ptr, i8, i64, i1)")
        size = slot.length * self.width * slot.dtype.itemsize
        self.lines.append(f"  call void @{function}(ptr align 64 {place}, i8 0, i64 {size}, i1 false)")

    def rarely(self, value: Value, wide: bool) -> str:
        """Write the choice between a usual value and the result of a subroutine, lane by lane.

        The subroutine is called only if at least one lane needs it.

        Args:
            value: The chosen value, an operation ``rarely``.
            wide: Whether the value is a vector of lanes.

        Returns:
            The register of the chosen value.
        """
        condition, usual_value, *arguments = value.operands
        kind = self.kind(value.dtype, wide)
        mask = self.read(condition, wide)
        width = self.width if wide else 1
        function = f"{value.detail.name}_{width}"
        self.subroutines[function] = value.detail, width
        typed_arguments = ", ".join(f"{self.kind(x.dtype, wide)} {self.read(x, wide)}" for x in arguments)
        usual_register = self.read(usual_value, wide)
        is_taken = self.any_lane(mask) if wide else mask
        rare_label = self.new_name("rare")
        end = self.new_name("end")
        entry = self.current()
        self.lines.append(f"  br i1 {is_taken}, label %{rare_label}, label %{end}, !prof !0")
        self.begin(rare_label)
        rare_register = self.emit(f"call {kind} @{function}({typed_arguments})")
        selector = f"{self.kind(BOOL, wide)} {mask}"
        merged_register = self.emit(f"select {selector}, {kind} {rare_register}, {kind} {usual_register}")
        self.lines.append(f"  br label %{end}")
        self.begin(end)
        return self.emit(f"phi {kind} [ {usual_register}, %{entry} ], [ {merged_register}, %{rare_label} ]")

    def arithmetic(self, operation: str, dtype: np.dtype, wide: bool, names: Sequence[str]) -> str:
        """Write an operation whose result has the type of its operands; return the register of the result.

        Args:
            operation: The operation.
            dtype: Dtype of operands and result.
            wide: Whether they are vectors of lanes.
            names: Register or literal of each operand.
        """
        kind = self.kind(dtype, wide)
        if dtype.kind == "f":
            if operation == "neg":
                return self.emit(f"fneg {self.flags}{kind} {names[0]}")
            if operation in CALLED:
                return self.call(f"llvm.{CALLED[operation]}.{self.suffix(dtype, wide)}", kind, (kind, names[0]))
            return self.emit(f"{FLOATS[operation]} {self.flags}{kind} {names[0]}, {names[1]}")
        if operation == "neg":
            return self.emit(f"sub {kind} {self.zero(dtype, wide)}, {names[0]}")
        if operation == "abs":
            if dtype.kind == "u":
                return names[0]
            least_is_kept = ("i1", "false")  # the absolute value of the least integer wraps, and is no poison
            return self.call(f"llvm.abs.{self.suffix(dtype, wide)}", kind, (kind, names[0]), least_is_kept)
        if operation in ("floor", "ceil", "round", "trunc"):
            return names[0]
        by_sign = SIGNED if dtype.kind == "i" else UNSIGNED
        instruction = INTEGERS[operation] if operation in INTEGERS else by_sign[operation]
        result = self.emit(f"{instruction} {kind} {names[0]}, {names[1]}")
        if operation == "add" and dtype.kind == "u" and not wide:
            return self.opaque(kind, result)
        return result

    def opaque(self, kind: str, name: str) -> str:
        """Write a copy of a number that stops LLVM's analysis of the number's sum; return the copy's register.

        LLVM's loop strength reduction tries all orders of a sum of scalars that contains the loop's counter. The words
        of random numbers are such sums, of twenty rounds, and the pass would take several seconds for them.

        Args:
            kind: LLVM's type of the number.
            name: Register of the number.
        """
        return self.emit(f"freeze {kind} {name}")

    def zero(self, dtype: np.dtype, wide: bool) -> str:
        """Return the literal of a scalar 0, or of a vector of zeros if ``wide``."""
        return "zeroinitializer" if wide else literal(0, dtype)

    def compare(self, operation: str, dtype: np.dtype, wide: bool, names: Sequence[str]) -> str:
        """Write a comparison of two numbers; return its register. If one is NaN, only ``ne`` is true.

        Args:
            operation: The comparison, a key of :data:`~dssc_jax.lanes.operations.COMPARISONS`.
            dtype: Dtype of the numbers.
            wide: Whether they are vectors of lanes.
            names: Register or literal of each number.
        """
        kind = self.kind(dtype, wide)
        if dtype.kind == "f":
            return self.emit(f"fcmp {FLOAT_COMPARISONS[operation]} {kind} {names[0]}, {names[1]}")
        sign = ""
        if operation not in ("eq", "ne"):
            sign = "s" if dtype.kind == "i" else "u"
        return self.emit(f"icmp {sign}{operation} {kind} {names[0]}, {names[1]}")

    def extreme(self, operation: str, value: Value, wide: bool, names: Sequence[str]) -> str:
        """Write the larger or smaller of two numbers, NaN if either is NaN; return its register.

        Floating-point numbers whose sign bit is always 0 are compared by their bits as integers, among which NaN is the
        largest. For other numbers, the comparison with a NaN is false, and ``select`` returns its last operand. So a
        constant operand, which is not NaN, comes first.

        Args:
            operation: ``max`` or ``min``.
            value: The result.
            wide: Whether the result is a vector of lanes.
            names: Register or literal of each operand.
        """
        kind = self.kind(value.dtype, wide)
        mask = self.kind(BOOL, wide)
        if operation == "max" and value.dtype.kind == "f" and is_unsigned(value):
            return self.largest_by_bits(value.dtype, wide, names)
        if value.dtype.kind == "f" and self.flags == STRICT:  # the larger of zeros is +0
            function = f"llvm.{operation}imum.{self.suffix(value.dtype, wide)}"
            return self.call(function, kind, *((kind, name) for name in names))
        first, second = names
        if value.operands[1].operation == "constant":
            first, second = second, first
        comparison = "gt" if operation == "max" else "lt"
        is_first_extreme = self.compare(comparison, value.dtype, wide, [first, second])
        extreme_register = self.emit(f"select {mask} {is_first_extreme}, {kind} {first}, {kind} {second}")
        has_number = any(operand.operation == "constant" and not np.isnan(operand.detail) for operand in value.operands)
        if value.dtype.kind != "f" or has_number:
            return extreme_register
        is_nan = self.emit(f"fcmp uno {kind} {first}, {first}")
        return self.emit(f"select {mask} {is_nan}, {kind} {first}, {kind} {extreme_register}")

    def largest_by_bits(self, dtype: np.dtype, wide: bool, names: Sequence[str]) -> str:
        """Write the larger of two floating-point numbers whose sign bit is 0; return its register.

        The order of such numbers is that of their bits as integers.

        Args:
            dtype: Dtype of the numbers.
            wide: Whether they are vectors of lanes.
            names: Register or literal of each number.
        """
        integer = np.dtype(f"i{dtype.itemsize}")
        kind = self.kind(integer, wide)
        bits = [(kind, self.convert("bitcast", dtype, integer, wide, name)) for name in names]
        largest = self.call(f"llvm.smax.{self.suffix(integer, wide)}", kind, *bits)
        return self.convert("bitcast", integer, dtype, wide, largest)

    def convert(self, operation: str, source: np.dtype, dtype: np.dtype, wide: bool, name: str) -> str:
        """Write the conversion of a number to another dtype; return the register of the result.

        Args:
            operation: ``bitcast``, which keeps the bits, or ``convert``, which keeps the number.
            source: Dtype of the number.
            dtype: Dtype of the result.
            wide: Whether both are vectors of lanes.
            name: Register or literal of the number.
        """
        old = self.kind(source, wide)
        new = self.kind(dtype, wide)
        same_size = source.itemsize == dtype.itemsize
        both_integers = source.kind in "iu" and dtype.kind in "iu"
        if operation == "bitcast" or (both_integers and same_size):
            return name if old == new else self.emit(f"bitcast {old} {name} to {new}")
        integer = dtype if source.kind == "f" else source
        signed = integer.kind == "i"
        if source.kind == "f" and dtype.kind != "f":  # numbers beyond the range become its ends
            conversion = "fptosi" if signed else "fptoui"
            function = f"llvm.{conversion}.sat.{self.suffix(dtype, wide)}.{self.suffix(source, wide)}"
            return self.call(function, new, (old, name))
        if source.kind == "f":
            instruction = "fpext" if dtype.itemsize > source.itemsize else "fptrunc"
        elif dtype.kind == "f":
            instruction = "sitofp" if signed else "uitofp"
        elif dtype.itemsize < source.itemsize and source != BOOL:
            instruction = "trunc"
        else:
            instruction = "sext" if signed else "zext"
        return self.emit(f"{instruction} {old} {name} to {new}")

    def lookup(self, value: Value, wide: bool) -> str:
        """Write the instructions that read an element of a constant table; return the element's register.

        Args:
            value: The element; its detail is the table. An index beyond the end gives the last element.
            wide: Whether the element is a vector, with an index of each lane.
        """
        index = value.operands[0]
        dtype = stored_type(value.dtype)
        scalar = scalar_type(dtype)
        table = self.define_table(value.detail, dtype)
        index_kind = self.kind(index.dtype, wide)
        limited_index = self.limited_index(index, value.detail.size - 1, wide)
        places = self.emit(f"getelementptr {scalar}, ptr {table}, {index_kind} {limited_index}", "p")
        if not wide:
            return self.from_stored(value.dtype, False, self.emit(f"load {scalar}, ptr {places}"))
        kind = self.kind(dtype, True)
        mask = self.kind(BOOL, True)
        pointers = f"<{self.width} x ptr>"
        function = f"llvm.masked.gather.{self.suffix(dtype, True)}.v{self.width}p0"
        self.declarations.add(f"declare {kind} @{function}({pointers}, {mask}, {kind})")
        arguments = f"{pointers} align {dtype.itemsize} {places}, {mask} splat (i1 true), {kind} poison"
        return self.from_stored(value.dtype, True, self.emit(f"call {kind} @{function}({arguments})"))

    def define_table(self, table: np.ndarray, dtype: np.dtype) -> str:
        """Define a constant table in the module; return its name.

        Args:
            table: The numbers, shape (n,).
            dtype: Dtype in which memory holds them.
        """
        scalar = scalar_type(dtype)
        name = f"@t{len(self.tables)}"
        numbers = ", ".join(f"{scalar} {literal(number, dtype)}" for number in table)
        self.tables.append(f"{name} = private constant [{table.size} x {scalar}] [{numbers}]")
        return name

    def limited_index(self, index: Value, largest: int, wide: bool) -> str:
        """Write the smaller of an index and ``largest``; return its register.

        An index can be too large because precomputation computes values for turns beyond a loop's end. As an unsigned
        number, a negative index is too large as well.
        """
        kind = self.kind(index.dtype, wide)
        limit = f"splat ({scalar_type(index.dtype)} {largest})" if wide else str(largest)
        function = f"llvm.umin.{self.suffix(index.dtype, wide)}"
        return self.call(function, kind, (kind, self.read(index, wide)), (kind, limit))
