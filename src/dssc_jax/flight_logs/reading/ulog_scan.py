"""A pass over a ULog's messages, which counts them by topic, and goes on after bytes that are no message.

After damage, the pass goes on at the first byte from which several sound messages follow one another, or at a
synchronisation message. A message of a topic is sound if its size agrees with the topic's format.
"""

import bisect
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

import numpy as np

from dssc_jax.flight_logs.reading.frames import MICROSECOND
from dssc_jax.flight_logs.reading.ulog_messages import (
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
CHAIN_READ = 40  # messages that are read to find them: the damage may have hidden the numbers of some topics
USUAL_DIGITS = 3  # binary digits that a usual interval may have more than the median one
WINDOW = 1 << 16  # bytes that are searched at a time


class Stamps(NamedTuple):
    """Two successive stamps of a topic, from the beginning of the log [s]; NaN where there are none."""

    early: float = np.nan
    late: float = np.nan


class LogTopic(NamedTuple):
    """One instance of a topic.

    Args:
        name: ``topic``, or ``topic:1`` for its second instance.
        messages: Number of messages.
        first: Time of the first message with a stamp, from the beginning of the log [s]; NaN if none has a stamp.
        last: Time of the last message with a stamp [s].
        falls: Number of messages with an earlier stamp than the message before.
        fall: Stamps before and after the first such fall [s]; NaN if there is none.
        usual_rate: Rate of messages where none are missing [1/s]; NaN of a single message.
        gap: Stamps before and after the longest time without a message [s]; NaN of a single message.
    """

    name: str
    messages: int
    first: float
    last: float
    falls: int = 0
    fall: Stamps = Stamps()
    usual_rate: float = np.nan
    gap: Stamps = Stamps()

    @property
    def rate(self) -> float:
        """Rate of messages between the first and the last one [1/s]; if stamps fall, the usual rate."""
        span = self.last - self.first
        return self.usual_rate if self.falls or not span > 0.0 else (self.messages - 1) / span


class TopicCount:
    """The messages of a topic so far, and their stamps.

    Args:
        sizes: The sizes that messages of the topic may have.
    """

    __slots__ = (
        "fall",
        "falls",
        "first",
        "gap",
        "intervals",
        "last",
        "messages",
        "shorter_gap",
        "sizes",
        "stamp_after_fall",
        "sums",
    )

    def __init__(self, sizes: BodySizes) -> None:
        self.sizes = sizes
        self.messages = 0
        self.first: int | None = None  # us, as all stamps
        self.last = 0
        self.gap = self.shorter_gap = (0, 0)  # stamps around the longest interval, and around the longest before it
        self.stamp_after_fall = 0  # stamp after the last fall
        self.falls = 0  # stamps that are earlier than the one before
        self.fall: tuple[int, int] | None = None  # stamps around the first of them
        self.intervals = [0] * 65  # number of intervals, by the binary digits of their length
        self.sums = [0] * 65  # total length of these intervals, by the same digits

    def add(self, stamp: int) -> None:
        """Count a message with a stamp [us]; a stamp of 0 stands for none."""
        self.messages += 1
        if not stamp:
            return
        if self.first is None:
            self.first = stamp
        else:
            step = stamp - self.last
            if step < 0:
                self.falls += 1
                self.stamp_after_fall = stamp
                self.fall = self.fall or (self.last, stamp)
                if self.last == self.gap[1]:  # a stray stamp is no gap
                    self.gap = self.shorter_gap
            else:
                digits = step.bit_length()
                self.intervals[digits] += 1
                self.sums[digits] += step
                if step > self.gap[1] - self.gap[0] and self.last != self.stamp_after_fall:
                    self.shorter_gap = self.gap
                    self.gap = (self.last, stamp)
        self.last = stamp

    def usual_rate(self) -> float:
        """Rate of messages [1/s], without intervals of more than about eight times the median; NaN without any."""
        interval_count = sum(self.intervals)
        cumulative_count = 0
        for digits, count in enumerate(self.intervals):
            cumulative_count += count
            if 2 * cumulative_count > interval_count:
                number, total = (sum(values[: digits + USUAL_DIGITS + 1]) for values in (self.intervals, self.sums))
                return number / (MICROSECOND * total) if total else np.nan
        return np.nan

    def topic(self, name: str, begin: int) -> LogTopic:
        """Describe the topic, by its name and the time at which the log begins [us]."""

        def seconds(stamps: tuple[int, int] | None) -> Stamps:
            return Stamps() if stamps is None else Stamps(*(MICROSECOND * (stamp - begin) for stamp in stamps))

        begin_time, last = seconds(None if self.first is None else (self.first, self.last))
        gap = seconds(self.gap if self.gap[1] else None)
        return LogTopic(
            name=name,
            messages=self.messages,
            first=begin_time,
            last=last,
            falls=self.falls,
            fall=seconds(self.fall),
            usual_rate=self.usual_rate(),
            gap=gap,
        )


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
        self._counts: dict[int, TopicCount] = {}
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
            if len(body) == size and (self._count(body) if kind == DATA else self._record(kind, body, file.tell())):
                continue
            place = file.tell() - len(body) - MESSAGE.size
            if len(body) < size and self._is_sound_head(head + body[: STAMPED.size]):
                self.cut = True
                return
            end = self._next_message(file, place + 1)
            self.damages.append(Damage(place, end))
            file.seek(end)

    def _count(self, body: bytes) -> bool:
        """Count a message of a topic by its stamp; False if there is no such topic, or the size is impossible."""
        size = len(body)
        if size < STAMPED.size:
            return False
        number, stamp = STAMPED.unpack_from(body)
        count = self._counts.get(number)
        if count is None or not count.sizes.smallest <= size <= count.sizes.largest:
            return False
        count.add(stamp)
        return True

    def _sizes(self, number: int) -> BodySizes | None:
        """The sizes that the messages of a topic may have; None: there is no such topic."""
        count = self._counts.get(number)
        return None if count is None else count.sizes

    def _record(self, kind: int, body: bytes, end: int) -> bool:
        """Record a format, a topic, a dropout or the place of the flags from a message; False if it is not sound.

        Args:
            kind: Kind of the message.
            body: Body of the message.
            end: Place in the file right after the message.
        """
        if not is_sound_text(kind, body):
            return False
        if kind == FORMAT:
            name, _, fields = body.decode().partition(":")
            self._formats[name] = fields
        elif kind == TOPIC:
            instance, number = ADDED.unpack_from(body)
            name = body[ADDED.size :].decode()
            self._names[number] = f"{name}:{instance}" if instance else name
            sizes = message_sizes(name, self._formats)
            self._counts.setdefault(number, TopicCount(sizes)).sizes = sizes
        elif kind == DROPPED:
            count, lost_time = self.dropouts
            self.dropouts = (count + 1, lost_time + 1e-3 * DROPOUT.unpack_from(body)[0])
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
        sizes = self._sizes(STAMPED.unpack_from(head, MESSAGE.size)[0])
        return sizes is not None and sizes.smallest <= size <= sizes.largest

    def _next_message(self, file: BinaryIO, place: int) -> int:
        """Find the first place, at or after a given one, where sound messages go on; the log's end if there is none."""
        longest_head = MESSAGE.size + STAMPED.size
        while True:
            file.seek(place)
            window = file.read(WINDOW)
            if len(window) < MESSAGE.size:
                return place + len(window)
            is_last_window = len(window) < WINDOW
            searched_bytes = len(window) - (MESSAGE.size if is_last_window else longest_head)
            for start in range(searched_bytes):
                if window[start + 2] not in KINDS or not self._is_sound_head(window[start : start + longest_head]):
                    continue
                if self._has_sound_chain(file, place + start):
                    return place + start
            if is_last_window:
                return place + len(window)
            place += searched_bytes

    def _has_sound_chain(self, file: BinaryIO, place: int) -> bool:
        """Whether several sound messages follow one another from a place on; fewer suffice at the end of the log."""
        file.seek(place)
        sound_count = 0
        for count in range(CHAIN_READ):
            head = file.read(MESSAGE.size)
            if not head:
                return sound_count > 0
            if len(head) < MESSAGE.size:
                return sound_count > 1
            size, kind = MESSAGE.unpack(head)
            body = file.read(size)
            if len(body) < size:
                return sound_count > 1
            if kind == DATA:
                if size < STAMPED.size:
                    return False
                sizes = self._sizes(STAMPED.unpack_from(body)[0])
                is_sound = sizes is not None and sizes.smallest <= size <= sizes.largest
                if (sizes is not None or count == 0) and not is_sound:
                    return False
                sound_count += is_sound
            elif is_sound_text(kind, body):
                sound_count += 1
            else:
                return False
            if sound_count == CHAIN or body == SYNCHRONISATION:
                return True
        return False

    def topics(self) -> Iterator[LogTopic]:
        """The topics that have messages."""
        for number, count in self._counts.items():
            if count.messages:
                yield count.topic(self._names[number], self._begin)


class UndamagedBytes:
    """A file object that reads a log's file as if some of its bytes were not there.

    Args:
        file: The log.
        damages: Bytes to leave out, in order.
        size: Size of the file [bytes].
    """

    def __init__(self, file: BinaryIO, damages: list[Damage], size: int) -> None:
        self._file = file
        self._begins = [0, *(damage.end for damage in damages)]  # the parts' beginnings in the file
        ends = [*(damage.begin for damage in damages), size]
        self._starts = [0]  # the parts' beginnings in the remaining bytes, and the end of these
        for begin, end in zip(self._begins, ends, strict=True):
            self._starts.append(self._starts[-1] + end - begin)
        self._position = 0

    def read(self, size: int = -1) -> bytes:
        """Read the next remaining bytes, at most ``size``; all of them if ``size`` is negative."""
        end = self._starts[-1] if size < 0 else min(self._position + size, self._starts[-1])
        chunks = []
        while self._position < end:
            index = bisect.bisect_right(self._starts, self._position) - 1
            offset = self._position - self._starts[index]
            self._file.seek(self._begins[index] + offset)
            chunk = self._file.read(min(end, self._starts[index + 1]) - self._position)
            if not chunk:
                break
            chunks.append(chunk)
            self._position += len(chunk)
        return b"".join(chunks)

    def seek(self, offset: int, origin: int = 0) -> int:
        """Go to a place in the remaining bytes; the offset counts from the beginning, the present place or the end."""
        start = (0, self._position, self._starts[-1])[origin]
        self._position = max(start + offset, 0)
        return self._position

    def tell(self) -> int:
        """The present place in the remaining bytes."""
        return self._position

    def close(self) -> None:
        """Close the file."""
        self._file.close()
