"""A pass over a ULog's messages, which counts them by topic, and goes on after bytes that are no message.

After damage the pass goes on at the first byte from which several sound messages follow one another, or at a
synchronisation message. A message of a topic is sound if its size is that of the topic's format.
"""

import bisect
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

import numpy as np

from dssc_jax.flight_logs.frames import MICROSECOND
from dssc_jax.flight_logs.ulog_messages import (
    ADDED,
    DATA,
    DROPOUT,
    DROPPED,
    FLAGS,
    FORMAT,
    KINDS,
    MESSAGE,
    STAMPED,
    SYNCHRONISATION,
    TOPIC,
    BodySizes,
    is_sound_text,
    message_sizes,
)

CHAIN = 5  # sound messages that show where a log goes on
CHAIN_READ = 40  # messages that are looked at for them: topics may have been lost with their numbers
WINDOW = 1 << 16  # bytes that are searched at a time


class LogTopic(NamedTuple):
    """One instance of a topic.

    Args:
        name: ``topic``, or ``topic:1`` for its second instance.
        messages: Number of its messages.
        first: Time of the first one with a stamp, from the beginning of the log [s]; NaN if none has.
        last: Time of the last one [s].
    """

    name: str
    messages: int
    first: float
    last: float

    @property
    def rate(self) -> float:
        """Messages a second between the first and the last one; NaN of a single one."""
        span = self.last - self.first
        return (self.messages - 1) / span if span > 0.0 else float("nan")


class Damage(NamedTuple):
    """Bytes of a log that are no message, from the first one to the message after them."""

    begin: int
    end: int


class Scan:
    """A pass over the messages of a log.

    Args:
        begin: The time at which the log begins [us].

    Attributes:
        damages: Bytes that are no message.
        flags: The place of the message of flags, if there is one.
        dropouts: Number of gaps in writing, and their sum [s].
        cut: Whether the file ends within a message.
    """

    def __init__(self, begin: int) -> None:
        self._begin = begin
        self._formats: dict[str, str] = {}
        self._names: dict[int, str] = {}
        self._sizes: dict[int, BodySizes] = {}
        self._counts: dict[int, int] = {}
        self._first: dict[int, int] = {}
        self._last: dict[int, int] = {}
        self.damages: list[Damage] = []
        self.flags: Damage | None = None
        self.dropouts = (0, 0.0)
        self.cut = False

    def run(self, file: BinaryIO) -> None:
        """Read all messages from the present position on."""
        read = file.read
        while True:
            head = read(MESSAGE.size)
            if len(head) < MESSAGE.size:
                self.cut = len(head) > 0
                return
            size, kind = MESSAGE.unpack(head)
            body = read(size)
            if len(body) == size and (self._count(body) if kind == DATA else self._note(kind, body, file.tell())):
                continue
            place = file.tell() - len(body) - MESSAGE.size
            if len(body) < size and self._is_sound_head(head + body[: STAMPED.size]):
                self.cut = True
                return
            end = self._next_message(file, place + 1)
            self.damages.append(Damage(place, end))
            file.seek(end)

    def _count(self, body: bytes) -> bool:
        """Count a message of a topic, whose first field is its stamp; False: there is no such topic, or size."""
        size = len(body)
        if size < STAMPED.size:
            return False
        number, stamp = STAMPED.unpack_from(body)
        sizes = self._sizes.get(number)
        if sizes is None or not sizes.smallest <= size <= sizes.largest:
            return False
        self._counts[number] = self._counts.get(number, 0) + 1
        if stamp:
            self._first.setdefault(number, stamp)
            self._last[number] = stamp
        return True

    def _note(self, kind: int, body: bytes, end: int) -> bool:
        """Note a format, a topic or a dropout of a message that has an end; False: it is none."""
        if not is_sound_text(kind, body):
            return False
        if kind == FORMAT:
            name, _, fields = body.decode().partition(":")
            self._formats[name] = fields
        elif kind == TOPIC:
            instance, number = ADDED.unpack_from(body)
            name = body[ADDED.size :].decode()
            self._names[number] = f"{name}:{instance}" if instance else name
            self._sizes[number] = message_sizes(name, self._formats)
        elif kind == DROPPED:
            count, lost = self.dropouts
            self.dropouts = (count + 1, lost + 1e-3 * DROPOUT.unpack_from(body)[0])
        elif kind == FLAGS and self.flags is None:
            self.flags = Damage(end - len(body) - MESSAGE.size, end)
        return True

    def _is_sound_head(self, head: bytes) -> bool:
        """Whether the first bytes of a message, up to a stamp, may be those of a sound one."""
        if len(head) < MESSAGE.size + STAMPED.size:
            return len(head) < MESSAGE.size or head[2] in KINDS
        size, kind = MESSAGE.unpack_from(head)
        if kind != DATA:
            return kind in KINDS
        sizes = self._sizes.get(STAMPED.unpack_from(head, MESSAGE.size)[0])
        return sizes is not None and sizes.smallest <= size <= sizes.largest

    def _next_message(self, file: BinaryIO, place: int) -> int:
        """The first place from a place on at which the log goes on; its end if there is none."""
        longest_head = MESSAGE.size + STAMPED.size
        while True:
            file.seek(place)
            window = file.read(WINDOW)
            if len(window) < MESSAGE.size:
                return place + len(window)
            ends = len(window) < WINDOW
            searched = len(window) - (MESSAGE.size if ends else longest_head)
            for start in range(searched):
                if window[start + 2] not in KINDS or not self._is_sound_head(window[start : start + longest_head]):
                    continue
                if self._goes_on(file, place + start):
                    return place + start
            if ends:
                return place + len(window)
            place += searched

    def _goes_on(self, file: BinaryIO, place: int) -> bool:
        """Whether several sound messages follow one another from a place on, or the last ones of the log."""
        file.seek(place)
        sound = 0
        for count in range(CHAIN_READ):
            head = file.read(MESSAGE.size)
            if not head:
                return sound > 0
            if len(head) < MESSAGE.size:
                return sound > 1
            size, kind = MESSAGE.unpack(head)
            body = file.read(size)
            if len(body) < size:
                return sound > 1
            if kind == DATA:
                if size < STAMPED.size:
                    return False
                sizes = self._sizes.get(STAMPED.unpack_from(body)[0])
                known = sizes is not None and sizes.smallest <= size <= sizes.largest
                if (sizes is not None or count == 0) and not known:
                    return False
                sound += known
            elif is_sound_text(kind, body):
                sound += 1
            else:
                return False
            if sound == CHAIN or body == SYNCHRONISATION:
                return True
        return False

    def topics(self) -> Iterator[LogTopic]:
        """The topics that have messages."""
        for number, messages in self._counts.items():
            spans = (self._first.get(number), self._last.get(number))
            first, last = (np.nan if stamp is None else MICROSECOND * (stamp - self._begin) for stamp in spans)
            yield LogTopic(self._names[number], messages, first, last)


class UndamagedPart:
    """A log's file without some of its bytes, to be read from its beginning to its end.

    Args:
        file: The log.
        damages: Bytes to leave out, in order.
        size: The file's size.
    """

    def __init__(self, file: BinaryIO, damages: list[Damage], size: int) -> None:
        self._file = file
        self._begins = [0, *(damage.end for damage in damages)]  # of the parts, in the file
        ends = [*(damage.begin for damage in damages), size]
        self._places = [0]  # of the parts' ends in what is read
        for begin, end in zip(self._begins, ends, strict=True):
            self._places.append(self._places[-1] + end - begin)
        self._place = 0

    def read(self, size: int = -1) -> bytes:
        """The bytes that follow, at most ``size``."""
        end = self._places[-1] if size < 0 else min(self._place + size, self._places[-1])
        parts = []
        while self._place < end:
            part = bisect.bisect_right(self._places, self._place) - 1
            self._file.seek(self._begins[part] + self._place - self._places[part])
            found = self._file.read(min(end, self._places[part + 1]) - self._place)
            if not found:
                break
            parts.append(found)
            self._place += len(found)
        return b"".join(parts)

    def seek(self, offset: int, origin: int = 0) -> int:
        """Go to a place, from the beginning, the present one or the end."""
        start = (0, self._place, self._places[-1])[origin]
        self._place = max(start + offset, 0)
        return self._place

    def tell(self) -> int:
        """The present place."""
        return self._place

    def close(self) -> None:
        """Close the file."""
        self._file.close()
