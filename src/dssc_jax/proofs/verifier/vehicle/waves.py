"""Sums of sines in balls. A phasor c for each frequency f stands for the sum of Re(c e^(2 pi i f t)) over all f.

Frequencies are exact rational numbers, so that the difference of two equal frequencies is exactly zero.
"""

from collections.abc import Mapping, Sequence
from fractions import Fraction

from flint import acb, arb, fmpq

from dssc_jax.proofs.verifier.balls import total

Waves = Mapping[Fraction, acb]
"""Phasor of each frequency [Hz], which is not negative; a constant has the frequency 0 and a real phasor."""


def sum_of_sines(sines: Sequence[tuple[Fraction, acb]]) -> dict[Fraction, acb]:
    """Add up single sines to a sum with one phasor for each frequency.

    Args:
        sines: Frequency [Hz], which may be negative, and phasor of each sine.
    """
    result: dict[Fraction, acb] = {}
    for frequency, phasor in sines:
        if frequency < 0:  # Re(c e^(-i w t)) is Re(conj(c) e^(i w t))
            frequency = -frequency
            phasor = phasor.conjugate()
        elif frequency == 0:
            phasor = acb(phasor.real)
        result[frequency] = result.get(frequency, acb(0)) + phasor
    return result


def sine_wave(sine: Sequence[float]) -> Waves:
    """The sine amplitude sin(2 pi t/period + phase) of a certificate's reference, as a sum of one sine.

    Args:
        sine: Amplitude [m, rad], period [s] and phase [rad].
    """
    amplitude, period, phase = sine
    frequency = 1 / Fraction(period)
    size = arb(amplitude)
    angle = arb(phase)
    phasor = acb(size * angle.sin(), -size * angle.cos())
    return {frequency: phasor}


def angular_frequency(frequency: Fraction) -> arb:
    """The angular frequency [rad/s] that belongs to a frequency [Hz]."""
    return 2 * arb.pi() * arb(fmpq(frequency.numerator, frequency.denominator))


def derivative(waves: Waves) -> Waves:
    """The derivative of a sum of sines with respect to time."""
    return {frequency: phasor * acb(0, angular_frequency(frequency)) for frequency, phasor in waves.items()}


def multiple(waves: Waves, factor: arb) -> Waves:
    """A sum of sines times a number."""
    return {frequency: phasor * factor for frequency, phasor in waves.items()}


def wave_sum(*sums: Waves) -> Waves:
    """The sum of several sums of sines."""
    return sum_of_sines([sine for waves in sums for sine in waves.items()])


def product(left: Waves, right: Waves) -> Waves:
    """The product of two sums of sines: sines of the sums and of the differences of the frequencies."""
    sines = []
    for left_frequency, a in left.items():
        for right_frequency, b in right.items():
            sines.append((left_frequency + right_frequency, a * b / 2))
            sines.append((left_frequency - right_frequency, a * b.conjugate() / 2))
    return sum_of_sines(sines)


def largest_magnitude(waves: Waves) -> arb:
    """A bound of the magnitude of a sum of sines at all times: the sum of the amplitudes."""
    return total([abs(phasor).upper() for phasor in waves.values()]).upper()


def value_at_start(waves: Waves) -> arb:
    """The value of a sum of sines at t = 0."""
    return total([phasor.real for phasor in waves.values()])
