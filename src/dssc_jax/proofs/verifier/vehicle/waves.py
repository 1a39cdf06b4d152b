"""Sums of sines in balls: the phasor c of each frequency f [Hz], whose sine is the real part of c e^(2 pi i f t).

Frequencies are exact rational numbers, so that the difference of two equal ones is exactly zero.
"""

from collections.abc import Mapping, Sequence
from fractions import Fraction

from flint import acb, arb, fmpq

from dssc_jax.proofs.verifier.balls import total

Waves = Mapping[Fraction, acb]
"""Phasors by frequency, which is not negative; the phasor of a constant is real."""


def sum_of_sines(parts: Sequence[tuple[Fraction, acb]]) -> dict[Fraction, acb]:
    """The sum of single sines, whose frequencies may be negative."""
    result: dict[Fraction, acb] = {}
    for frequency, phasor in parts:
        if frequency < 0:
            frequency, phasor = -frequency, phasor.conjugate()
        elif frequency == 0:
            phasor = acb(phasor.real)
        result[frequency] = result.get(frequency, acb(0)) + phasor
    return result


def sine_wave(sine: Sequence[float]) -> Waves:
    """The sine of a certificate: amplitude, period and phase."""
    amplitude, phase = arb(sine[0]), arb(sine[2])
    return {1 / Fraction(sine[1]): acb(amplitude * phase.sin(), -amplitude * phase.cos())}


def angular(frequency: Fraction) -> arb:
    """The angular frequency [rad/s]."""
    return 2 * arb.pi() * arb(fmpq(frequency.numerator, frequency.denominator))


def rate(waves: Waves) -> Waves:
    """The derivative in time."""
    return {frequency: phasor * acb(0, angular(frequency)) for frequency, phasor in waves.items()}


def multiple(waves: Waves, factor: arb) -> Waves:
    """A sum times a number."""
    return {frequency: phasor * factor for frequency, phasor in waves.items()}


def sum_of(*sums: Waves) -> Waves:
    """The sum of sums."""
    return sum_of_sines([part for waves in sums for part in waves.items()])


def times(left: Waves, right: Waves) -> Waves:
    """The product: cosines of the sums and of the differences of the angles, with half the amplitudes."""
    parts = []
    for f, a in left.items():
        for h, b in right.items():
            parts.append((f + h, a * b / 2))
            parts.append((f - h, a * b.conjugate() / 2))
    return sum_of_sines(parts)


def largest(waves: Waves) -> arb:
    """A bound of the magnitude at all times."""
    return total([abs(phasor).upper() for phasor in waves.values()]).upper()


def at_start(waves: Waves) -> arb:
    """The value at t = 0."""
    return total([phasor.real for phasor in waves.values()])
