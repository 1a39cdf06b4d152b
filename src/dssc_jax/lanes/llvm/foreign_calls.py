"""The text for LLVM of a function that calls a function of C for each lane of a vector.

A buffer holds the vectors of operands, one after another. For each lane, the function clears the memory of a call, puts
the lane's operands in their places, makes the call, and copies the results to a second buffer. The memory is cleared
for each lane, so that no lane sees what another one has left.
"""

from dssc_jax.lanes.foreign import ALIGNMENT, ForeignFunction, MemoryPlace
from dssc_jax.lanes.llvm.function_text import scalar_type


def column_bytes(place: MemoryPlace, width: int) -> int:
    """Return the bytes of a buffer that hold one number of each lane, rounded up to whole lines of the cache.

    Args:
        place: Place of the number in a call's memory, which gives its dtype.
        width: Number of lanes in a vector.
    """
    lines = -(-place.dtype.itemsize * width // ALIGNMENT)  # rounded up
    return lines * ALIGNMENT


def buffer_bytes(places: tuple[MemoryPlace, ...], width: int) -> int:
    """Return the bytes of a buffer for the vectors of some numbers; ``width`` is the number of lanes in a vector."""
    return sum(column_bytes(place, width) for place in places)


def columns(places: tuple[MemoryPlace, ...], width: int) -> list[tuple[MemoryPlace, int]]:
    """Return, for each number, its place in a call's memory and the offset of its vector in a buffer [bytes].

    Args:
        places: Places of the numbers.
        width: Number of lanes of a vector.
    """
    pairs: list[tuple[MemoryPlace, int]] = []
    start = 0
    for place in places:
        pairs.append((place, start))
        start += column_bytes(place, width)
    return pairs


def over_lanes(function: ForeignFunction, width: int) -> str:
    """Return the name of the generated function that calls a function of C for each of ``width`` lanes."""
    return f"{function.symbol}_over_{width}"


def definition(function: ForeignFunction, width: int) -> list[str]:
    """Return the lines of the generated function that calls a function of C for each of ``width`` lanes.

    The generated function has two arguments: the address of the buffer with the operands, and that of the buffer for
    the results.
    """
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
    """Return the lines that copy one number of the present lane between a buffer and the memory of the call.

    Args:
        name: Prefix of the names of registers.
        place: Place of the number in the memory.
        column: Name of the buffer, and offset of the number's vector in the buffer [bytes].
        to_memory: True: from the buffer to the memory; false: from the memory to the buffer.
    """
    kind = scalar_type(place.dtype)
    align = place.dtype.itemsize
    buffer, start = column
    vector = f"%{name}c"  # registers with the addresses of the vector, of the lane's element, of the place in memory
    element = f"%{name}e"
    in_memory = f"%{name}m"
    source, target = (element, in_memory) if to_memory else (in_memory, element)
    return [
        f"  {vector} = getelementptr i8, ptr {buffer}, i64 {start}",
        f"  {element} = getelementptr {kind}, ptr {vector}, i64 %i",
        f"  {in_memory} = getelementptr i8, ptr %memory, i64 {place.offset}",
        f"  %{name} = load {kind}, ptr {source}, align {align}",
        f"  store {kind} %{name}, ptr {target}, align {align}",
    ]
