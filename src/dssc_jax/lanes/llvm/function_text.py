"""The text of a function of LLVM as it is being written: its lines, the registers of values, and its basic blocks."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from dssc_jax.lanes.program import BOOL, Subroutine, Value

FAST, STRICT = "contract nsz ", ""
"""LLVM's flags of arithmetic. FAST allows LLVM to contract a product and a sum, and to ignore the sign of zero."""


def scalar_type(dtype: np.dtype) -> str:
    """Return LLVM's type of a scalar of a dtype, such as ``double`` or ``i32``."""
    if dtype.kind == "f":
        return {4: "float", 8: "double"}[dtype.itemsize]
    return "i1" if dtype == BOOL else f"i{8 * dtype.itemsize}"


def literal(number: Any, dtype: np.dtype) -> str:
    """Return a number as a literal of LLVM, which takes a floating-point number of any size as the bits of float64."""
    if dtype == BOOL:
        return "true" if number else "false"
    if dtype.kind == "f":
        big_endian_bytes = struct.pack(">d", float(number))
        return f"0x{big_endian_bytes.hex().upper()}"
    return str(int(number))


def positions(lanes: range) -> str:
    """Return the literal of the positions of lanes, the mask of LLVM's instruction shufflevector."""
    numbers = ", ".join(f"i32 {lane}" for lane in lanes)
    return f"<{len(lanes)} x i32> <{numbers}>"


class RegisterUse(NamedTuple):
    """How a function spares registers on a processor that has few of them.

    Args:
        stored_constants: Whether operations read constants from memory, as whole vectors.
        piece_width: Number of lanes in a piece of a vector, if each operation is written once for each piece. A vector
            consists of 1, 2, 4 or 8 pieces. 0: each operation is written for the whole vector.
    """

    stored_constants: bool = False
    piece_width: int = 0


MANY_REGISTERS = RegisterUse()


@dataclass
class FunctionText:
    """The lines of a function of LLVM so far, with the register of each value.

    Args:
        width: Number of lanes in a vector.
        flags: :data:`FAST` or :data:`STRICT`.
        register_use: How the function spares registers.
        lines: The instructions so far.
        tables: Definitions of constant tables.
        names: Register of each value, by the value's id and whether it is a vector.
        declarations: Declarations of LLVM's functions and of constants.
        subroutines: Subroutines that are called, with the width of their vectors, by name.
        count: Number of names so far.
        label: Label of the present basic block.
        allocated: Instructions that reserve memory, for the start of the function.
        slots: Register with the address of each slot, by the slot's id.
        pieces: Registers of the pieces of each value, by the value's id.
        piece: Position of the piece for which an operation is being written; None: it is written for whole vectors.
    """

    width: int
    flags: str = FAST
    register_use: RegisterUse = MANY_REGISTERS
    lines: list[str] = field(default_factory=list)
    tables: list[str] = field(default_factory=list)
    names: dict[tuple[int, bool], str] = field(default_factory=dict)
    declarations: set[str] = field(default_factory=set)
    subroutines: dict[str, tuple[Subroutine, int]] = field(default_factory=dict)
    count: int = 0
    label: str = "entry"
    allocated: list[str] = field(default_factory=list)
    slots: dict[int, str] = field(default_factory=dict)
    pieces: dict[int, list[str]] = field(default_factory=dict)
    piece: int | None = None

    # Names and types

    def new_name(self, prefix: str = "v") -> str:
        """Return an unused name for a register or label: the prefix and a number."""
        self.count += 1
        return f"{prefix}{self.count}"

    def kind(self, dtype: np.dtype, vector: bool) -> str:
        """Return LLVM's type of a scalar or, if ``vector`` and a vector has several lanes, of a vector of lanes."""
        scalar = scalar_type(dtype)
        return f"<{self.width} x {scalar}>" if vector and self.width > 1 else scalar

    def emit(self, text: str, prefix: str = "v") -> str:
        """Write an instruction; return the register of its result.

        Args:
            text: The instruction, without the result.
            prefix: Prefix of the register's name.
        """
        name = f"%{self.new_name(prefix)}"
        self.lines.append(f"  {name} = {text}")
        return name

    def read(self, value: Value, vector: bool) -> str:
        """Return the register or literal of a value, as a vector or as a scalar.

        While an operation is written for a piece of a vector, the register is that of the value's same piece.
        """
        vector = vector and self.width > 1
        if value.operation == "constant":
            number = literal(value.detail, value.dtype)
            return f"splat ({scalar_type(value.dtype)} {number})" if vector else number
        if vector and self.piece is not None:
            return self.pieces[id(value)][self.piece]
        return self.names[id(value), vector]

    def operand(self, value: Value, vector: bool) -> str:
        """Return the register or literal of a value, for operations that may read a constant from memory.

        The arguments are those of :meth:`read`. If the processor has few registers, a constant vector of floating-point
        numbers other than 0 is stored in memory, and an instruction that loads it is written.
        """
        is_number = value.operation == "constant" and value.dtype.kind == "f" and value.detail != 0
        is_stored = self.register_use.stored_constants and vector and self.width > 1 and is_number
        if not is_stored:
            return self.read(value, vector)
        kind = self.kind(value.dtype, True)
        bits = literal(value.detail, value.dtype)
        name = f"@number.{8 * value.dtype.itemsize}.{self.width}.{bits}"
        self.declarations.add(f"{name} = private unnamed_addr constant {kind} {self.read(value, True)}, align 64")
        return self.emit(f"load {kind}, ptr {name}, align 64", "c")

    def is_vector(self, value: Value) -> bool:
        """Whether a value is computed as a vector: it varies between lanes, and there are several lanes."""
        return value.varying and self.width > 1

    def splat(self, dtype: np.dtype, name: str) -> str:
        """Write the instructions for a vector whose elements all equal a scalar; return the vector's register.

        Args:
            dtype: Dtype of the scalar.
            name: Register of the scalar.
        """
        scalar = scalar_type(dtype)
        kind = self.kind(dtype, True)
        inserted = self.emit(f"insertelement {kind} poison, {scalar} {name}, i64 0", "s")
        return self.emit(f"shufflevector {kind} {inserted}, {kind} poison, <{self.width} x i32> zeroinitializer", "s")

    def name(self, value: Value, name: str) -> None:
        """Store ``name`` as the register of a value.

        For a uniform value, a vector of equal elements is also written, and its register stored. Where operations are
        written for pieces of a vector, the pieces are written and their registers stored as well.
        """
        vector = self.is_vector(value)
        self.names[id(value), vector] = name
        if not vector and self.width > 1:
            self.names[id(value), True] = self.splat(value.dtype, name)
        if self.register_use.piece_width:
            self.pieces[id(value)] = self.separated(value.dtype, self.names[id(value), True])

    def separated(self, dtype: np.dtype, vector: str) -> list[str]:
        """Write the instructions that split a vector into its pieces; return the pieces' registers.

        Args:
            dtype: Dtype of the elements.
            vector: Register of the vector.
        """
        kind = self.kind(dtype, True)
        piece_width = self.register_use.piece_width
        registers = []
        for first in range(0, self.width, piece_width):
            lanes = range(first, first + piece_width)
            registers.append(self.emit(f"shufflevector {kind} {vector}, {kind} poison, {positions(lanes)}", "h"))
        return registers

    def joined(self, dtype: np.dtype, pieces: Sequence[str]) -> str:
        """Write the instructions that join pieces, two at a time, to a vector; return the vector's register.

        Args:
            dtype: Dtype of the elements.
            pieces: Registers of the pieces, in order.
        """
        scalar = scalar_type(dtype)
        registers = list(pieces)
        width = self.register_use.piece_width
        while len(registers) > 1:
            kind = f"<{width} x {scalar}>"
            width *= 2
            pairs = zip(registers[::2], registers[1::2], strict=True)
            registers = [
                self.emit(f"shufflevector {kind} {first}, {kind} {second}, {positions(range(width))}", "w")
                for first, second in pairs
            ]
        return registers[0]

    def call(self, function: str, result: str, *arguments: tuple[str, str]) -> str:
        """Write a call of one of LLVM's functions; return the result's register.

        Args:
            function: Name of the function.
            result: Type of the result.
            arguments: Type and register of each argument.
        """
        kinds = ", ".join(kind for kind, _ in arguments)
        typed_registers = ", ".join(f"{kind} {register}" for kind, register in arguments)
        self.declarations.add(f"declare {result} @{function}({kinds})")
        return self.emit(f"call {result} @{function}({typed_registers})")

    def suffix(self, dtype: np.dtype, vector: bool) -> str:
        """Return the name of a type within the names of LLVM's functions, such as "v4f64" in llvm.sqrt.v4f64.

        Args:
            dtype: Dtype of a scalar.
            vector: Whether the type is that of a vector of lanes.
        """
        scalar = f"f{8 * dtype.itemsize}" if dtype.kind == "f" else scalar_type(dtype)
        return f"v{self.width}{scalar}" if vector and self.width > 1 else scalar

    def column(self, array: str, position: int) -> str:
        """Write the instructions that load the address of a column; return the register with the address.

        Args:
            array: Name of the table of addresses, ``inputs`` or ``outputs``.
            position: Position of the column in the table.
        """
        place = self.emit(f"getelementptr ptr, ptr %{array}, i64 {position}", "p")
        return self.emit(f"load ptr, ptr {place}", "p")

    # Basic blocks

    def begin(self, label: str) -> None:
        """Begin a basic block with this label."""
        self.lines.append(f"{label}:")
        self.label = label

    def current(self) -> str:
        """Return the label of the basic block that is being written."""
        return self.label
