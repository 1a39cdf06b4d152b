"""Sums of sines: a dictionary holds the phasor of each frequency [Hz], of which the sine is the real part."""

import math
from fractions import Fraction

from dssc_jax.proofs.vehicle_problem import VehicleProblem

Waves = dict[Fraction, complex]
"""Phasor of each frequency; that of a constant is real."""


def add(waves: Waves, frequency: Fraction, phasor: complex) -> None:
    """Add a sine to a sum, in place; its frequency may be negative."""
    if frequency < 0:
        frequency = -frequency
        phasor = phasor.conjugate()
    if frequency == 0:
        phasor = complex(phasor.real)
    waves[frequency] = waves.get(frequency, 0.0) + phasor


def product(left: Waves, right: Waves, factor: float) -> Waves:
    """The product of two sums of sines and a factor."""
    result: Waves = {}
    for f, a in left.items():
        for h, b in right.items():
            add(result, f + h, 0.5 * factor * a * b)
            add(result, f - h, 0.5 * factor * a * b.conjugate())
    return result


def total(*sums: Waves) -> Waves:
    """The sum of several sums of sines."""
    result: Waves = {}
    for waves in sums:
        for frequency, phasor in waves.items():
            add(result, frequency, phasor)
    return result


def rate_of(frequency: Fraction) -> float:
    """The angular frequency [rad/s] of a frequency [Hz]."""
    return 2.0 * math.pi * float(frequency)


def derivative(waves: Waves) -> Waves:
    """The derivative of a sum of sines in time."""
    return {frequency: 1j * rate_of(frequency) * phasor for frequency, phasor in waves.items()}


def multiple(waves: Waves, factor: float) -> Waves:
    """A sum of sines times a factor."""
    return {frequency: factor * phasor for frequency, phasor in waves.items()}


def size(waves: Waves) -> float:
    """A bound of the magnitude of a sum of sines at all times."""
    return sum(abs(phasor) for phasor in waves.values())


def reference_waves(problem: VehicleProblem) -> dict[str, Waves]:
    """The sine that each axis follows, by axis; the problem must have a reference."""
    assert problem.reference is not None
    result = {}
    for axis, (amplitude, period, phase) in problem.reference.items():
        result[axis] = {1 / Fraction(period): amplitude * complex(math.sin(phase), -math.cos(phase))}
    return result
