"""Sums of sines. A phasor X for each frequency f stands for the sum of Re(X e^(2 pi i f t)) over all f."""

import math
from fractions import Fraction

from dssc_jax.proofs.vehicle_problem import VehicleProblem

Waves = dict[Fraction, complex]
"""Phasor of each frequency [Hz]; a constant has the frequency 0 and a real phasor."""


def add(waves: Waves, frequency: Fraction, phasor: complex) -> None:
    """Add the sine Re(phasor e^(2 pi i frequency t)) to a sum, in place; the frequency [Hz] may be negative."""
    if frequency < 0:  # Re(X e^(-i w t)) is Re(conj(X) e^(i w t))
        frequency = -frequency
        phasor = phasor.conjugate()
    if frequency == 0:
        phasor = complex(phasor.real)
    waves[frequency] = waves.get(frequency, 0.0) + phasor


def product(left: Waves, right: Waves, factor: float) -> Waves:
    """The product of two sums of sines and a number: sines of the sums and of the differences of the frequencies.

    Re(a e^(i w t)) Re(b e^(i v t)) is half of Re(a b e^(i (w + v) t)) + Re(a conj(b) e^(i (w - v) t)).
    """
    result: Waves = {}
    for left_frequency, a in left.items():
        for right_frequency, b in right.items():
            add(result, left_frequency + right_frequency, 0.5 * factor * a * b)
            add(result, left_frequency - right_frequency, 0.5 * factor * a * b.conjugate())
    return result


def wave_sum(*sums: Waves) -> Waves:
    """The sum of several sums of sines."""
    result: Waves = {}
    for waves in sums:
        for frequency, phasor in waves.items():
            add(result, frequency, phasor)
    return result


def angular_frequency(frequency: Fraction) -> float:
    """The angular frequency [rad/s] that belongs to a frequency [Hz]."""
    return 2.0 * math.pi * float(frequency)


def derivative(waves: Waves) -> Waves:
    """The derivative of a sum of sines with respect to time."""
    return {frequency: 1j * angular_frequency(frequency) * phasor for frequency, phasor in waves.items()}


def multiple(waves: Waves, factor: float) -> Waves:
    """A sum of sines times a factor."""
    return {frequency: factor * phasor for frequency, phasor in waves.items()}


def largest_magnitude(waves: Waves) -> float:
    """A bound of the magnitude of a sum of sines at all times: the sum of the amplitudes."""
    return sum(abs(phasor) for phasor in waves.values())


def reference_waves(problem: VehicleProblem) -> dict[str, Waves]:
    """The sine that each axis follows, by axis; the problem must have a reference."""
    assert problem.reference is not None
    result = {}
    for axis, (amplitude, period, phase) in problem.reference.items():
        phasor = amplitude * complex(math.sin(phase), -math.cos(phase))  # of amplitude sin(2 pi t/period + phase)
        result[axis] = {1 / Fraction(period): phasor}
    return result
