"""The messages of a ULog: what a sound one looks like, by its kind and by the formats of its topics.

Source: PX4 user guide, "ULog file format".
"""

import re
import struct
from collections.abc import Mapping
from typing import NamedTuple

MESSAGE = struct.Struct("<HB")  # size and kind
ADDED = struct.Struct("<BH")  # instance and number of a topic
STAMPED = struct.Struct("<HQ")
DROPOUT = struct.Struct("<H")
SYNCHRONISATION = bytes.fromhex("2f731320250cbb12")
KINDS = frozenset(b"BFIMPQALCDRSO")
"""Kinds of messages: flags, format, information, parameter, topic, text, data, removal, synchronisation, dropout."""
DATA = ord("D")
TOPIC = ord("A")
DROPPED = ord("O")
FORMAT = ord("F")
FLAGS = ord("B")
LARGEST_TEXT = 4096  # bytes of a message that is no data
FIXED_SIZES = {DROPPED: 2, ord("R"): 2, FLAGS: 40}
LEAST_SIZES = {ord("L"): 9, ord("C"): 11, TOPIC: 4}
KEY_PLACES = {ord("I"): 0, ord("P"): 0, ord("M"): 1, ord("Q"): 1}
"""Bytes before the length of the key, of the messages that have a key and a value."""
TYPE_SIZES = {
    "int8_t": 1,
    "uint8_t": 1,
    "int16_t": 2,
    "uint16_t": 2,
    "int32_t": 4,
    "uint32_t": 4,
    "int64_t": 8,
    "uint64_t": 8,
    "float": 4,
    "double": 8,
    "bool": 1,
    "char": 1,
}
FIELD = re.compile(r"(\w+)(?:\[(\d+)\])? (\S+)")
PADDING = "_padding"


class BodySizes(NamedTuple):
    """The sizes that the messages of a topic may have [bytes], including the two bytes of the topic's number."""

    smallest: int  # without the padding at the end
    largest: int


ANY_SIZE = BodySizes(STAMPED.size, 0xFFFF)


def message_sizes(name: str, formats: Mapping[str, str]) -> BodySizes:
    """The sizes that a topic's messages may have by the log's formats; any size if the log lacks one of the formats.

    Args:
        name: Name of the topic's format.
        formats: The fields of each format, as text, by name.
    """
    try:
        smallest, largest = field_sizes(name, formats)
    except (KeyError, RecursionError):
        return ANY_SIZE
    return BodySizes(max(2 + smallest, STAMPED.size), 2 + largest)


def field_sizes(name: str, formats: Mapping[str, str]) -> tuple[int, int]:
    """The bytes of a format's fields without and with the padding at its end; raises KeyError for an unknown type.

    Args:
        name: Name of the format.
        formats: The fields of each format, as text, by name.
    """
    padded = 0
    unpadded = 0
    for text in formats[name].split(";"):
        match = FIELD.fullmatch(text.strip())
        if match is None:
            continue
        kind, count, label = match.groups()
        single = TYPE_SIZES[kind] if kind in TYPE_SIZES else field_sizes(kind, formats)[1]
        padded += single * int(count or 1)
        if not label.startswith(PADDING):
            unpadded = padded
    return unpadded, padded


def is_sound_text(kind: int, body: bytes) -> bool:
    """Whether a body is possible for a message of a kind other than data.

    Args:
        kind: Kind of the message, as a byte.
        body: Body of the message, without its head.
    """
    if kind not in KINDS or kind == DATA:
        return False
    size = len(body)
    if kind == ord("S"):
        return body == SYNCHRONISATION
    if kind in FIXED_SIZES:
        return size == FIXED_SIZES[kind] or (kind != FLAGS and size > FIXED_SIZES[kind])
    if kind in KEY_PLACES:
        return is_sound_value(body[KEY_PLACES[kind] :])
    if kind == FORMAT:
        return body.find(b":") > 0 and is_plain(body)
    return LEAST_SIZES[kind] <= size <= LARGEST_TEXT and (kind != TOPIC or is_plain(body[ADDED.size :]))


def is_sound_value(body: bytes) -> bool:
    """Whether bytes are, in this order, the length of a key, a key such as ``float NAME``, and a value of that type."""
    if not body or len(body) <= body[0]:
        return False
    key = body[1 : 1 + body[0]]
    match = FIELD.fullmatch(key.decode("ascii", "replace"))
    if match is None or not is_plain(key) or match[1] not in TYPE_SIZES:
        return False
    return len(body) - 1 - len(key) == TYPE_SIZES[match[1]] * int(match[2] or 1)


def is_plain(text: bytes) -> bool:
    """Whether bytes are printable ASCII."""
    return all(0x20 <= byte < 0x7F for byte in text)
