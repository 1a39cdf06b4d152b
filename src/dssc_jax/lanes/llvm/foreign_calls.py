"""LLVM's text of a function that calls a function of C for each lane of a vector.

The vectors of operands lie one after another in a buffer. For each lane the function clears the memory of a call, puts
the lane's operands in their places, calls, and collects the results in a second buffer. The memory is cleared for each
lane, so that no lane sees what another one left.
"""

from dssc_jax.lanes.foreign import ALIGNMENT, ForeignFunction, MemoryPlace
from dssc_jax.lanes.llvm.instructions import scalar_type


def column_bytes(place: MemoryPlace, width: int) -> int:
    """Bytes of a buffer that the vector of a number takes."""
    return -(-place.dtype.itemsize * width // ALIGNMENT) * ALIGNMENT


def buffer_bytes(places: tuple[MemoryPlace, ...], width: int) -> int:
    """Bytes of a buffer for the vectors of some numbers."""
    return sum(column_bytes(place, width) for place in places)


def columns(places: tuple[MemoryPlace, ...], width: int) -> list[tuple[MemoryPlace, int]]:
    """Each number, and where its vector begins in a buffer."""
    pairs: list[tuple[MemoryPlace, int]] = []
    start = 0
    for place in places:
        pairs.append((place, start))
        start += column_bytes(place, width)
    return pairs


def over_lanes(function: ForeignFunction, width: int) -> str:
    """Name of the function that calls another one for each lane."""
    return f"{function.symbol}_over_{width}"


def definition(function: ForeignFunction, width: int) -> list[str]:
    """The lines of that function."""
    lines = [
        f"define internal void @{over_lanes(function, width)}(ptr noalias %in, ptr noalias %out) #2 {{",
        "entry:",
        f"  %memory = alloca [{function.size} x i8], align {ALIGNMENT}",
        "  br label %lane",
        "lane:",
        "  %i = phi i64 [ 0, %entry ], [ %next, %lane ]",
        f"  call void @llvm.memset.p0.i64(ptr align {ALIGNMENT} %memory, i8 0, i64 {function.size}, i1 false)",
    ]
    for number, (place, start) in enumerate(columns(function.operands, width)):
        lines += move_lines(f"a{number}", place, ("%in", start), to_memory=True)
    lines.append(f"  call void @{function.symbol}(ptr %memory)")
    for number, (place, start) in enumerate(columns(function.results, width)):
        lines += move_lines(f"r{number}", place, ("%out", start), to_memory=False)
    return [
        *lines,
        "  %next = add i64 %i, 1",
        f"  %more = icmp ult i64 %next, {width}",
        "  br i1 %more, label %lane, label %done",
        "done:",
        "  ret void",
        "}",
    ]


def move_lines(name: str, place: MemoryPlace, column: tuple[str, int], to_memory: bool) -> list[str]:
    """The lines that move one number of the present lane between its column of a buffer and the memory."""
    kind = scalar_type(place.dtype)
    align = place.dtype.itemsize
    buffer, start = column
    source, target = (f"%{name}e", f"%{name}m") if to_memory else (f"%{name}m", f"%{name}e")
    return [
        f"  %{name}c = getelementptr i8, ptr {buffer}, i64 {start}",
        f"  %{name}e = getelementptr {kind}, ptr %{name}c, i64 %i",
        f"  %{name}m = getelementptr i8, ptr %memory, i64 {place.offset}",
        f"  %{name} = load {kind}, ptr {source}, align {align}",
        f"  store {kind} %{name}, ptr {target}, align {align}",
    ]
