"""LLVM's instructions for the single values of a program."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dssc_jax.lanes.interface import stored_type
from dssc_jax.lanes.operations import COMPARISONS
from dssc_jax.lanes.passes.signs import is_unsigned
from dssc_jax.lanes.program import BOOL, Slot, Subroutine, Value

FAST, STRICT = "contract nsz ", ""
FLOATS = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv", "rem": "frem"}
INTEGERS = {"add": "add", "sub": "sub", "mul": "mul", "and": "and", "or": "or", "xor": "xor", "shl": "shl"}
SIGNED = {"div": "sdiv", "rem": "srem", "shr": "ashr"}
UNSIGNED = {"div": "udiv", "rem": "urem", "shr": "lshr"}
CALLED = {"sqrt": "sqrt", "floor": "floor", "ceil": "ceil", "round": "roundeven", "trunc": "trunc", "abs": "fabs"}
FLOAT_COMPARISONS = {"eq": "oeq", "ne": "une", "lt": "olt", "le": "ole", "gt": "ogt", "ge": "oge"}


def scalar_type(dtype: np.dtype) -> str:
    """LLVM's type of a dtype."""
    if dtype.kind == "f":
        return {4: "float", 8: "double"}[dtype.itemsize]
    return "i1" if dtype == BOOL else f"i{8 * dtype.itemsize}"


def literal(number: Any, dtype: np.dtype) -> str:
    """A number as a literal of LLVM."""
    if dtype == BOOL:
        return "true" if number else "false"
    if dtype.kind == "f":
        return f"0x{struct.pack('>d', float(number)).hex().upper()}"
    return str(int(number))


@dataclass
class Instructions:
    """Writes LLVM's instructions for values, and stores the register of each value.

    Args:
        width: Lanes of a vector.
        flags: :data:`FAST` or :data:`STRICT`.
        stored_constants: Whether operations read constants from memory, as whole vectors, because registers are few.
        lines: The instructions so far.
        tables: Definitions of constant tables.
        names: Register of each value, by the value's id and whether it is a vector.
        declarations: Declarations of LLVM's functions and of constants.
        subroutines: Subroutines that are called, with the width of their vectors, by name.
        count: Number of names so far.
        label: Label of the present basic block.
        allocated: Instructions that reserve memory, for the start of the function.
        slots: Register with the address of each slot, by the slot's id.
    """

    width: int
    flags: str = FAST
    stored_constants: bool = False
    lines: list[str] = field(default_factory=list)
    tables: list[str] = field(default_factory=list)
    names: dict[tuple[int, bool], str] = field(default_factory=dict)
    declarations: set[str] = field(default_factory=set)
    subroutines: dict[str, tuple[Subroutine, int]] = field(default_factory=dict)
    count: int = 0
    label: str = "entry"
    allocated: list[str] = field(default_factory=list)
    slots: dict[int, str] = field(default_factory=dict)

    # Names and types

    def new_name(self, prefix: str = "v") -> str:
        """A new name."""
        self.count += 1
        return f"{prefix}{self.count}"

    def kind(self, dtype: np.dtype, vector: bool) -> str:
        """LLVM's type of a scalar, or of a vector of lanes."""
        scalar = scalar_type(dtype)
        return f"<{self.width} x {scalar}>" if vector and self.width > 1 else scalar

    def emit(self, text: str, prefix: str = "v") -> str:
        """Write an instruction; return the register of its result."""
        name = f"%{self.new_name(prefix)}"
        self.lines.append(f"  {name} = {text}")
        return name

    def read(self, value: Value, vector: bool) -> str:
        """The register or literal of a value, as a vector or as a scalar."""
        vector = vector and self.width > 1
        if value.operation == "constant":
            number = literal(value.detail, value.dtype)
            return f"splat ({scalar_type(value.dtype)} {number})" if vector else number
        return self.names[id(value), vector]

    def operand(self, value: Value, vector: bool) -> str:
        """As :meth:`read`, for operations that may read constants from memory."""
        is_number = value.operation == "constant" and value.dtype.kind == "f" and value.detail != 0
        if not (self.stored_constants and vector and self.width > 1 and is_number):
            return self.read(value, vector)
        kind = self.kind(value.dtype, True)
        bits = literal(value.detail, value.dtype)
        name = f"@number.{8 * value.dtype.itemsize}.{self.width}.{bits}"
        self.declarations.add(f"{name} = private unnamed_addr constant {kind} {self.read(value, True)}, align 64")
        return self.emit(f"load {kind}, ptr {name}, align 64", "c")

    def is_vector(self, value: Value) -> bool:
        """Whether a value is computed as a vector."""
        return value.varying and self.width > 1

    def splat(self, dtype: np.dtype, name: str) -> str:
        """Write a vector whose elements all equal the scalar in a register; return its register."""
        scalar = scalar_type(dtype)
        kind = self.kind(dtype, True)
        inserted = self.emit(f"insertelement {kind} poison, {scalar} {name}, i64 0", "s")
        return self.emit(f"shufflevector {kind} {inserted}, {kind} poison, <{self.width} x i32> zeroinitializer", "s")

    def name(self, value: Value, name: str) -> None:
        """Store the register of a value; a uniform value gets a vector, too."""
        vector = self.is_vector(value)
        self.names[id(value), vector] = name
        if not vector and self.width > 1:
            self.names[id(value), True] = self.splat(value.dtype, name)

    def call(self, function: str, result: str, *arguments: tuple[str, str]) -> str:
        """Write a call of one of LLVM's functions; arguments are types with registers. Return the result's register."""
        kinds = ", ".join(kind for kind, _ in arguments)
        self.declarations.add(f"declare {result} @{function}({kinds})")
        return self.emit(f"call {result} @{function}({', '.join(' '.join(pair) for pair in arguments)})")

    def suffix(self, dtype: np.dtype, vector: bool) -> str:
        """The name of a type within the names of LLVM's functions."""
        scalar = f"f{8 * dtype.itemsize}" if dtype.kind == "f" else scalar_type(dtype)
        return f"v{self.width}{scalar}" if vector and self.width > 1 else scalar

    def column(self, array: str, position: int) -> str:
        """Write the loading of the address of an input's or output's column; return its register."""
        place = self.emit(f"getelementptr ptr, ptr %{array}, i64 {position}", "p")
        return self.emit(f"load ptr, ptr {place}", "p")

    # Basic blocks

    def begin(self, label: str) -> None:
        """Begin a basic block."""
        self.lines.append(f"{label}:")
        self.label = label

    def current(self) -> str:
        """The label of the basic block that is being written."""
        return self.label

    # Operations

    def any_lane(self, mask: str) -> str:
        """Write whether a truth value is true in any lane of a vector; return the register."""
        kind = self.kind(BOOL, True)
        return self.call(f"llvm.vector.reduce.or.v{self.width}i1", "i1", (kind, mask))

    def value(self, value: Value) -> str:
        """Write the instructions of one value; return its register."""
        operation = value.operation
        dtype = value.dtype
        wide = self.is_vector(value)
        kind = self.kind(dtype, wide)
        if operation == "input":
            return self.input(value, wide)
        if operation == "any":
            (mask,) = value.operands
            return self.any_lane(self.read(mask, True)) if self.is_vector(mask) else self.read(mask, False)
        if operation == "lookup":
            return self.lookup(value, wide)
        if operation == "rarely":
            return self.rarely(value, wide)
        if operation in ("memory", "read", "write"):
            return self.access(value)
        if operation == "select":
            condition, *cases = value.operands
            has_mask = self.is_vector(condition)
            first, second = (self.operand(case, wide) for case in cases)
            selector = f"{self.kind(BOOL, has_mask)} {self.read(condition, has_mask)}"
            return self.emit(f"select {selector}, {kind} {first}, {kind} {second}")
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
        """Write the loading of an input; return its register."""
        column = self.column("inputs", value.detail)
        dtype = stored_type(value.dtype)
        place = self.emit(f"getelementptr {scalar_type(dtype)}, ptr {column}, i64 %lane")
        loaded_register = self.emit(f"load {self.kind(dtype, wide)}, ptr {place}, align {dtype.itemsize}")
        return self.from_memory(value.dtype, wide, loaded_register)

    def from_memory(self, dtype: np.dtype, wide: bool, register: str) -> str:
        """The register of a loaded value; a truth value is converted from its byte."""
        if dtype != BOOL:
            return register
        return self.compare("ne", stored_type(BOOL), wide, [register, self.zero(BOOL, wide) if wide else "0"])

    def access(self, value: Value) -> str:
        """Write the reserving, reading or writing of a slot; return the register of the element or, else, of a zero.

        A token has no content of its own, so it is a zero.
        """
        slot: Slot = value.detail
        kind = self.kind(slot.dtype, True)
        if value.operation == "memory":
            place = self.slots[id(slot)] = f"%{self.new_name('slot')}"
            self.allocated.append(f"  {place} = alloca [{slot.length} x {kind}], align 64")
            function = "llvm.memset.p0.i64"
            self.declarations.add(f"declare void @{function}(ptr, i8, i64, i1)")
            size = slot.length * self.width * slot.dtype.itemsize
            self.lines.append(f"  call void @{function}(ptr align 64 {place}, i8 0, i64 {size}, i1 false)")
            return self.zero(value.dtype, self.width > 1)
        index = self.read(value.operands[1], False)
        place = self.emit(f"getelementptr {kind}, ptr {self.slots[id(slot)]}, i32 {index}", "p")
        aligned = f"align {slot.dtype.itemsize}"
        if value.operation == "read":
            return self.emit(f"load {kind}, ptr {place}, {aligned}")
        self.lines.append(f"  store {kind} {self.read(value.operands[2], True)}, ptr {place}, {aligned}")
        return self.zero(value.dtype, self.width > 1)

    def rarely(self, value: Value, wide: bool) -> str:
        """Write the choice between a value and the result of a subroutine, called only if a lane needs it.

        Returns:
            The register of the result.
        """
        condition, usual_value, *arguments = value.operands
        kind = self.kind(value.dtype, wide)
        mask = self.read(condition, wide)
        function = f"{value.detail.name}_{self.width if wide else 1}"
        self.subroutines[function] = value.detail, self.width if wide else 1
        arguments_text = ", ".join(f"{self.kind(x.dtype, wide)} {self.read(x, wide)}" for x in arguments)
        usual_register = self.read(usual_value, wide)
        is_taken = self.any_lane(mask) if wide else mask
        rare_label = self.new_name("rare")
        end = self.new_name("end")
        entry = self.current()
        self.lines.append(f"  br i1 {is_taken}, label %{rare_label}, label %{end}, !prof !0")
        self.begin(rare_label)
        rare_register = self.emit(f"call {kind} @{function}({arguments_text})")
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
            return self.call(f"llvm.abs.{self.suffix(dtype, wide)}", kind, (kind, names[0]), ("i1", "false"))
        if operation in ("floor", "ceil", "round", "trunc"):
            return names[0]
        notation = SIGNED if dtype.kind == "i" else UNSIGNED
        result = self.emit(f"{INTEGERS.get(operation) or notation[operation]} {kind} {names[0]}, {names[1]}")
        if operation == "add" and dtype.kind == "u" and not wide:
            return self.opaque(kind, result)
        return result

    def opaque(self, kind: str, name: str) -> str:
        """Write a copy of a number, which LLVM does not analyse; return its register.

        LLVM's loop strength reduction tries all orders of a sum of scalars that contains the loop's counter. The words
        of random numbers are such sums, of twenty rounds, and would take it several seconds.
        """
        return self.emit(f"freeze {kind} {name}")

    def zero(self, dtype: np.dtype, wide: bool) -> str:
        """The literal 0 of a scalar or vector."""
        return "zeroinitializer" if wide else literal(0, dtype)

    def compare(self, operation: str, dtype: np.dtype, wide: bool, names: Sequence[str]) -> str:
        """Write a comparison of numbers of a dtype, of which only ``ne`` is true for NaN; return its register."""
        kind = self.kind(dtype, wide)
        if dtype.kind == "f":
            return self.emit(f"fcmp {FLOAT_COMPARISONS[operation]} {kind} {names[0]}, {names[1]}")
        sign = ""
        if operation not in ("eq", "ne"):
            sign = "s" if dtype.kind == "i" else "u"
        return self.emit(f"icmp {sign}{operation} {kind} {names[0]}, {names[1]}")

    def extreme(self, operation: str, value: Value, wide: bool, names: Sequence[str]) -> str:
        """Write the larger or smaller of two numbers, NaN if either is; return its register.

        The bits of numbers without sign are compared as integers, among which NaN is the largest. For other numbers a
        ``select`` returns its last operand if an operand is NaN, so a constant, which is none, comes first.

        Args:
            operation: ``max`` or ``min``.
            value: The result.
            wide: Whether it is a vector of lanes.
            names: Register or literal of each operand.
        """
        kind = self.kind(value.dtype, wide)
        mask = self.kind(BOOL, wide)
        if operation == "max" and value.dtype.kind == "f" and is_unsigned(value):
            integer = np.dtype(f"i{value.dtype.itemsize}")
            bits = [(self.kind(integer, wide), self.convert("bitcast", value.dtype, integer, wide, n)) for n in names]
            largest = self.call(f"llvm.smax.{self.suffix(integer, wide)}", bits[0][0], *bits)
            return self.convert("bitcast", integer, value.dtype, wide, largest)
        if value.dtype.kind == "f" and self.flags == STRICT:  # the larger of zeros is +0
            function = f"llvm.{operation}imum.{self.suffix(value.dtype, wide)}"
            return self.call(function, kind, *((kind, name) for name in names))
        first, second = names
        if value.operands[1].operation == "constant":
            first, second = second, first
        if value.dtype.kind != "f":
            is_first_extreme = self.compare("gt" if operation == "max" else "lt", value.dtype, wide, [first, second])
            return self.emit(f"select {mask} {is_first_extreme}, {kind} {first}, {kind} {second}")
        is_first_extreme = self.emit(f"fcmp {'ogt' if operation == 'max' else 'olt'} {kind} {first}, {second}")
        extreme_register = self.emit(f"select {mask} {is_first_extreme}, {kind} {first}, {kind} {second}")
        if any(operand.operation == "constant" and operand.detail == operand.detail for operand in value.operands):
            return extreme_register
        is_nan = self.emit(f"fcmp uno {kind} {first}, {first}")
        return self.emit(f"select {mask} {is_nan}, {kind} {first}, {kind} {extreme_register}")

    def convert(self, operation: str, source: np.dtype, dtype: np.dtype, wide: bool, name: str) -> str:
        """Write the conversion of a number or, for ``bitcast``, of its bits; return its register.

        Args:
            operation: ``bitcast``, or any conversion of numbers.
            source: Type of the number.
            dtype: Type of the result.
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
        if source.kind == "f" and dtype.kind != "f":
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
        """Write the reading of an element of a constant table, at an index limited to its end; return its register."""
        table, (index,) = value.detail, value.operands
        dtype = stored_type(value.dtype)
        scalar = scalar_type(dtype)
        count = table.size
        name = f"@t{len(self.tables)}"
        numbers = ", ".join(f"{scalar} {literal(number, dtype)}" for number in table)
        self.tables.append(f"{name} = private constant [{count} x {scalar}] [{numbers}]")
        largest = f"{scalar_type(index.dtype)} {count - 1}"  # precomputation goes beyond a loop's end
        limit = (self.kind(index.dtype, wide), f"splat ({largest})" if wide else str(count - 1))
        typed = (self.kind(index.dtype, wide), self.read(index, wide))
        register = self.call(f"llvm.umin.{self.suffix(index.dtype, wide)}", limit[0], typed, limit)
        if not wide:
            place = self.emit(f"getelementptr {scalar}, ptr {name}, {scalar_type(index.dtype)} {register}", "p")
            return self.from_memory(value.dtype, False, self.emit(f"load {scalar}, ptr {place}"))
        kind = self.kind(dtype, True)
        mask = self.kind(BOOL, True)
        pointers = f"<{self.width} x ptr>"
        places = self.emit(f"getelementptr {scalar}, ptr {name}, {self.kind(index.dtype, True)} {register}", "p")
        function = f"llvm.masked.gather.{self.suffix(dtype, True)}.v{self.width}p0"
        self.declarations.add(f"declare {kind} @{function}({pointers}, {mask}, {kind})")
        arguments = f"{pointers} align {dtype.itemsize} {places}, {mask} splat (i1 true), {kind} poison"
        return self.from_memory(value.dtype, True, self.emit(f"call {kind} @{function}({arguments})"))
