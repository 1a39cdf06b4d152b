"""Hints that a logged signal is the study's with another sign, unit or start."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dssc_jax.core.flag_runs import longest_run

MOST_PRODUCTS = 20_000_000  # number of samples times number of shifts
SAME_REFERENCE = 0.01  # share of a reference's root mean square: closer, two references are the same
PREDICTED = 0.5  # share of a predicted output's root mean square: closer, a converted output looks like that one
ALIKE = 0.2  # share of an output's deviation from its straight line that may be left of another channel's output
LONGEST_DELAY = 25  # samples by which a channel may be late itself
DELAY_SHARE = 0.05  # of the samples, likewise
SHIFTED = 0.1  # largest deviation of an output from the shifted one, as a share of the shift
FOLLOWED = 0.7  # share of a reference's root mean square: closer, a converted output follows it
IN_PHASE = 0.2  # relative difference of the part in phase with a reference from a multiple of it
COMMAND_ROUNDING = 1e-3
"""Share of a command's root mean square: no smaller difference of two commands says anything."""
FEWER = 1.0 / 3.0  # share of the present distance: a conversion that leaves more says nothing


class Conversion(NamedTuple):
    """The hypothesis that a logged signal is a multiple of the expected one.

    Args:
        factor: The multiple.
        words: What to call it, such as "with the opposite sign".
        unit: What the expected signal's unit must begin with for ``meaning`` to apply; empty: any unit.
        meaning: The multiple in terms of units, such as "degrees in place of radians".
        restricted: Whether it is considered for signals of this unit alone: 57.3 means something for angles only.
    """

    factor: float
    words: str
    unit: str = ""
    meaning: str = ""
    restricted: bool = False

    def text(self, unit: str) -> str:
        """The words, with the meaning if it applies to a signal of this unit."""
        return f"{self.words} ({self.meaning})" if self.meaning and is_unit_of(unit, self.unit) else self.words

    def is_possible(self, unit: str) -> bool:
        """Whether the multiple means something for a signal of this unit."""
        return not self.restricted or is_unit_of(unit, self.unit)


GRAVITY = 9.80665  # m/s^2, the standard one, by which a kilogram-force is defined
OPPOSITE = "with the opposite sign"
CONVERSIONS = (
    Conversion(-1.0, OPPOSITE),
    Conversion(100.0, "times 100", "m", "centimetres in place of metres"),
    Conversion(1000.0, "times 1000", "m", "millimetres in place of metres"),
    Conversion(0.01, "times 0.01"),
    Conversion(0.001, "times 0.001"),
    Conversion(180.0 / np.pi, "times 57.3", "rad", "degrees in place of radians", restricted=True),
    Conversion(np.pi / 180.0, "times 0.01745", "deg", "radians in place of degrees", restricted=True),
    Conversion(1.0 / 0.3048, "times 3.281", "m", "feet in place of metres", restricted=True),
    Conversion(1.0 / GRAVITY, "times 0.102", "N", "kilograms-force in place of newtons", restricted=True),
    Conversion(1000.0 / GRAVITY, "times 102", "N", "grams-force in place of newtons", restricted=True),
    Conversion(GRAVITY, "times 9.807", "N", restricted=True),
    Conversion(1.0 / GRAVITY, "times 0.102", "m/s^2", "multiples of g in place of m/s^2", restricted=True),
    Conversion(GRAVITY, "times 9.807", "m/s^2", restricted=True),
    Conversion(
        GRAVITY, "times 9.807", "1", "newtons in place of kilograms-force, or m/s^2 in place of g", restricted=True
    ),
)
RATE_CONVERSIONS = (*CONVERSIONS, Conversion(3.6, "times 3.6", "m", "km/h in place of m/s"))
"""Conversions of a rate beside its output, which are told from each other even where they are near."""
SAME_MULTIPLE = 1.05  # factor between two multiples: closer, they are one, as 100 and 102
LEAST_FACTOR = 0.02  # least difference of a multiple from 1 that is reported
LARGE_MULTIPLE = 3.0  # of its reference that an output follows late
LATE_SHARE = 0.1  # of the samples by which it may be late
LATE_SIZE = 0.3  # relative difference of its root mean square from a multiple of it
MEAN = 0.3  # share of a reference's root mean square: the least mean that says something
FEW_SAMPLES = 0.005  # share of single samples at which a reference may differ that is the same: edges between two


def is_unit_of(unit: str, begin: str) -> bool:
    """Whether a unit is a base unit, or a quotient or product that begins with it: m/s is of m, mol is not."""
    return unit == begin or unit.startswith((f"{begin}/", f"{begin} "))


def rms(values: np.ndarray) -> float:
    """The root mean square of the finite values, however large they are; infinite if there are none."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return float("inf")
    size = float(np.abs(finite).max())
    return size * float(np.sqrt(np.mean((finite / size) ** 2))) if size > 0.0 else 0.0


def conversion_text(
    logged: np.ndarray, expected: np.ndarray, tolerance: float, unit: str, distance_without: float = np.inf
) -> str:
    """The multiple by which the logged signal differs from the expected one, in words; empty if none fits better.

    Args:
        logged: Values, NaN where missing, shape (samples,).
        expected: Values at the same times.
        tolerance: Largest root mean square of the difference, as a share of the expected signal's.
        unit: Unit of the expected signal.
        distance_without: Root mean square of the difference that another cause than a multiple leaves.
    """
    expected_rms = rms(expected[np.isfinite(logged)])
    if expected_rms == 0.0 or not np.isfinite(expected_rms):
        return ""
    best_text = ""
    smallest_distance = min(tolerance * expected_rms, FEWER * min(rms(logged - expected), distance_without))
    for conversion in CONVERSIONS:
        if not conversion.is_possible(unit):
            continue
        distance = rms(logged / conversion.factor - expected)
        if distance <= smallest_distance:
            smallest_distance = distance
            best_text = conversion.text(unit)
    return best_text


def multiple_of(logged: np.ndarray, expected: np.ndarray) -> float:
    """The factor by which a logged signal is a multiple of the expected one; 1 if it is the same, or another signal.

    Args:
        logged: Values, NaN where missing, shape (samples,).
        expected: Values at the same times.
    """
    has_both = np.isfinite(logged) & np.isfinite(expected)
    sizes = rms(logged[has_both]), rms(expected[has_both])
    if not 0.0 < min(sizes) <= max(sizes) < np.inf:
        return 1.0
    unit_logged = logged[has_both] / sizes[0]
    unit_expected = expected[has_both] / sizes[1]
    correlation = float(unit_logged @ unit_expected) / len(unit_logged)
    factor = correlation * (sizes[0] / sizes[1])
    is_another = rms(unit_logged - correlation * unit_expected) > SAME_REFERENCE
    return 1.0 if is_another or abs(factor - 1.0) <= LEAST_FACTOR else factor


def followed_conversion(logged: np.ndarray, reference: np.ndarray, unit: str) -> str:
    """The multiple of its reference that a logged output follows, in words; empty: it follows none.

    A closed loop follows its reference, so an output that follows a multiple is in another unit. A multiple counts if
    the part of the output in phase with the reference is nearly that multiple of it. The opposite sign counts only if
    the means are opposite, too, because a slow loop may lag by half a period.

    Args:
        logged: The output, NaN where missing, shape (samples,).
        reference: The reference of its channel in the study at the same times.
        unit: Unit of the output.
    """
    is_finite = np.isfinite(logged)
    if not is_finite.any():
        return ""
    square = float(reference[is_finite] @ reference[is_finite])
    factor = float(logged[is_finite] @ reference[is_finite]) / square if square > 0.0 else 0.0
    for conversion in CONVERSIONS:
        text = conversion.text(unit)
        is_near = abs(factor / conversion.factor - 1.0) <= IN_PHASE
        if text == OPPOSITE and not has_opposite_mean(logged[is_finite], reference[is_finite]):
            continue
        if is_near and conversion_text(logged, reference, FOLLOWED, unit) == text:
            return f"follows its reference {text}"
    return late_conversion(logged, reference, unit)


def late_conversion(logged: np.ndarray, reference: np.ndarray, unit: str) -> str:
    """The large multiple of its reference that an output follows late, as a slow loop does, in words; empty: none.

    No loop has three times the size of its reference and still looks like it. Opposite signs are not tried, because a
    lag of half a period looks the same.

    Args:
        logged: Values, NaN where missing, shape (samples,).
        reference: The channel's reference.
        unit: Unit of the output.
    """
    size = rms(reference)
    if not LARGE_MULTIPLE * size < rms(logged) < np.inf or size == 0.0:
        return ""
    text = ""
    least_distance = FOLLOWED * size
    for conversion in CONVERSIONS:
        if conversion.factor < LARGE_MULTIPLE or not conversion.is_possible(unit):
            continue
        for delay in range(int(LATE_SHARE * len(logged))):
            late = logged[delay:] / conversion.factor
            followed = reference[: len(late)]
            distance = rms(late - followed)
            sizes = rms(late), rms(followed[np.isfinite(late)])
            if distance < least_distance and abs(sizes[0] - sizes[1]) <= LATE_SIZE * sizes[1]:
                least_distance = distance
                text = f"follows its reference {conversion.text(unit)}, with a lag"
    return text


def has_opposite_mean(logged: np.ndarray, reference: np.ndarray) -> bool:
    """Whether a reference has a large mean, and the output nearly the opposite one; no lag turns the sign of a mean."""
    mean = float(reference.mean())
    return abs(mean) > MEAN * rms(reference) and abs(float(logged.mean()) / mean + 1.0) <= IN_PHASE


def likeness_text(
    index: int, logged: np.ndarray, expected: Sequence[np.ndarray], names: Sequence[str], unit: str
) -> str:
    """What a logged output looks like if it differs from its channel's expected output, in words; else empty.

    A hint names a cause, and a wrong one costs more than none. So the likeness has to be far closer than what a delay,
    an offset or a gain of the channel itself leaves: two channels that hover at one height, or that fly one manoeuvre a
    little apart, are alike by themselves.

    Args:
        index: Position of the channel.
        logged: Values, NaN where missing, shape (samples,).
        expected: The expected output of each channel at the same times.
        names: Names of the outputs.
        unit: Unit of the output.
    """
    pairs = delayed_pairs(logged, expected[index])
    multiple = conversion_text(
        logged, expected[index], PREDICTED, unit, min(rms(late - output) for late, output in pairs)
    )
    if multiple:
        return f"looks like the study's {multiple}"
    least_by_channel = min(rms(late - line_through(output, late)) for late, output in pairs)
    deviation = rms(logged - line_through(np.arange(len(logged), dtype=float), logged))
    smallest_distance = min(ALIKE * deviation, FEWER * least_by_channel)
    text = ""
    for channel, output in enumerate(expected):
        distance = rms(logged - output)
        if channel != index and distance <= smallest_distance:
            smallest_distance = distance
            text = f"looks like the study's {names[channel]}"
    return text or shift_text(logged, expected[index], unit)


def delayed_pairs(logged: np.ndarray, expected: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """A logged output and the expected one, for all delays and leads that the channel itself may have.

    Args:
        logged: Values, shape (samples,).
        expected: Values at the same times.

    Returns:
        Pairs of equal length: the logged values, and the expected ones that they are compared with.
    """
    pairs = [(logged, expected)]
    for delay in range(1, min(LONGEST_DELAY, int(DELAY_SHARE * len(logged))) + 1):
        pairs += [(logged[delay:], expected[:-delay]), (logged[:-delay], expected[delay:])]
    return pairs


def line_through(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The values a + b x of the line nearest to y in the mean square, shape (n,); x and y may have NaN."""
    is_finite = np.isfinite(x) & np.isfinite(y)
    if not is_finite.any():
        return np.full(len(y), np.nan)
    x_mean = float(x[is_finite].mean())
    y_mean = float(y[is_finite].mean())
    square = float(np.sum((x[is_finite] - x_mean) ** 2))
    slope = float((x[is_finite] - x_mean) @ (y[is_finite] - y_mean)) / square if square > 0.0 else 0.0
    return y_mean + slope * (x - x_mean)


def shift_text(logged: np.ndarray, expected: np.ndarray, unit: str) -> str:
    """The constant offset of a logged output from the expected one, in words; empty if there is none."""
    difference = logged - expected
    difference = difference[np.isfinite(difference)]
    if not difference.size:
        return ""
    shift = float(np.median(difference))
    is_small = abs(shift) <= SAME_REFERENCE * rms(expected)
    if is_small or not rms(difference - shift) <= SHIFTED * abs(shift):
        return ""
    return f"lies {shift:.4g} {unit} from the study's from the start on: compare the study's initial state"


def factor_text(ratio: np.ndarray, units: Sequence[str]) -> str:
    """The multiple that would bring a number into its law, in words; empty if none does, or several do.

    Args:
        ratio: The law's ends over the number.
        units: Units of the study's outputs and commands; a multiple of angles counts only where one is an angle.
    """
    low, high = np.sort(ratio)
    candidates = []
    for conversion in CONVERSIONS:
        is_inside = conversion.factor > 0.0 and low <= conversion.factor <= high
        if is_inside and any(conversion.is_possible(unit) for unit in units):
            candidates.append(conversion)
    factors = [conversion.factor for conversion in candidates]
    is_one = bool(candidates) and max(factors) <= SAME_MULTIPLE * min(factors)
    return candidates[0].words if is_one else ""


def reference_conversion(
    index: int, logged: np.ndarray, references: np.ndarray, channels: Sequence[str], unit: str
) -> str:
    """How a channel's logged reference follows from the study's, in words; empty if in no simple way.

    Args:
        index: Position of the channel.
        logged: The channel's logged reference, NaN where missing, shape (samples,).
        references: The study's references, shape (channels, samples).
        channels: Names of the channels.
        unit: Unit of the channel's output.
    """
    reference = references[index]
    distance = rms(logged - reference)
    if distance <= SAME_REFERENCE * rms(reference):
        return ""
    multiple = conversion_text(logged, reference, SAME_REFERENCE, unit)
    if multiple:
        return f"is the study's {multiple}"
    for row, channel in enumerate(channels):
        channel_rms = rms(references[row])
        if row != index and channel_rms > 0.0 and rms(logged - references[row]) <= SAME_REFERENCE * channel_rms:
            return f"is the study's of {channel}"
    return ""


def is_same_reference(logged: np.ndarray, reference: np.ndarray) -> bool:
    """Whether a logged reference is the study's.

    The references may differ at a few single samples, where an edge falls to the sample before or after.

    Args:
        logged: Values, NaN where missing, shape (samples,).
        reference: The study's at the same times.
    """
    tolerance = SAME_REFERENCE * rms(reference - np.mean(reference))
    difference = (logged - reference)[np.isfinite(logged)]
    is_different = np.abs(difference) > tolerance
    is_few = np.count_nonzero(is_different) <= FEW_SAMPLES * len(difference) and longest_run(is_different) <= 1
    return bool(is_few) or rms(difference) <= tolerance


def reference_shift(logged: np.ndarray, reference: np.ndarray) -> int:
    """The number of samples by which a logged reference is later than the study's; 0: it is the same, or no shift.

    Of several shifts the smallest counts, and none above half of the reference's period.
    """
    variation = rms(reference - np.mean(reference))
    if variation == 0.0 or is_same_reference(logged, reference):
        return 0
    samples = len(reference)
    longest = min(samples // 2, MOST_PRODUCTS // samples)
    for shift in range(1, min(longest, period_of(reference, longest) // 2) + 1):
        for shifted, original, result in (
            (logged[shift:], reference[:-shift], shift),
            (logged[:-shift], reference[shift:], -shift),
        ):
            has_variation = rms(original - np.mean(original)) > 0.5 * variation
            if has_variation and rms(shifted - original) <= SAME_REFERENCE * variation:
                return result
    return 0


def period_of(reference: np.ndarray, longest: int) -> int:
    """The period of a reference in samples: the least shift that agrees with it after a shorter one that does not.

    Args:
        reference: The reference, shape (samples,).
        longest: The longest period that is sought; twice this value is returned if there is none.
    """
    largest_difference = SAME_REFERENCE * rms(reference - np.mean(reference))
    has_differed = False
    for shift in range(1, longest + 1):
        agrees = rms(reference[shift:] - reference[:-shift]) <= largest_difference
        if agrees and has_differed:
            return shift
        has_differed |= not agrees
    return 2 * longest


def is_shifted(logged: np.ndarray, reference: np.ndarray, shift: int) -> bool:
    """Whether a logged reference agrees with the study's, shifted by a number of samples.

    A reference that never moves, or is not logged, agrees with any shift.
    """
    variation = rms(reference - np.mean(reference))
    if variation == 0.0 or not np.isfinite(logged).any():
        return True
    delay, lead = max(shift, 0), max(-shift, 0)
    samples = len(reference) - abs(shift)
    return rms(logged[delay : delay + samples] - reference[lead : lead + samples]) <= SAME_REFERENCE * variation
