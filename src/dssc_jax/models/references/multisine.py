"""A multisine: a sum of sines, with phases that keep its peak low.

In units, y stands for the unit of the plant's output.

References:
    L. Ljung, System Identification: Theory for the User, 2nd ed. (1999), section 13.3.
    M. R. Schroeder, Synthesis of low-peak-factor signals and binary sequences with low autocorrelation, IEEE Trans.
    Information Theory 16 (1970).
"""

import math
from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.contracts import Reference
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import ReferencePoint, Scalar


class MultisineParams(NamedTuple):
    """The sum of sines y_m = offset + the sum of a_k sin(2 pi f_k t + phi_k).

    Phases that are None become Schroeder's, with which sines of equal amplitudes have a low peak.
    """

    amplitudes: Annotated[tuple[Scalar, ...], Quantity("y", "amplitude of each sine")]
    frequencies: Annotated[tuple[Scalar, ...], Quantity("Hz", "frequency of each sine", above=0.0)]
    phases: Annotated[tuple[Scalar, ...] | None, Quantity("rad", "phase of each sine")] = None
    offset: Annotated[Scalar, Quantity("y", "mean value")] = 0.0


def multisine_at(params: MultisineParams, t: Scalar) -> ReferencePoint:
    """The multisine y_m and its derivatives y_m', y_m'' at t [s]."""
    y = params.offset
    y_dot = 0.0
    y_ddot = 0.0
    assert params.phases is not None  # prepare has set them
    for amplitude, frequency, phase in zip(params.amplitudes, params.frequencies, params.phases, strict=True):
        rate = 2.0 * math.pi * frequency
        angle = rate * t + phase
        swing = amplitude * jnp.sin(angle)
        y = y + swing
        y_dot = y_dot + amplitude * rate * jnp.cos(angle)
        y_ddot = y_ddot - rate * rate * swing
    return ReferencePoint(y, y_dot, y_ddot)


def schroeder_phases(count: int) -> tuple[float, ...]:
    """Schroeder's phases -k (k - 1) pi/n of the sines k = 1..n [rad], up to whole turns."""
    return tuple(-math.pi * ((k * (k - 1)) % (2 * count)) / count for k in range(1, count + 1))


def prepare_multisine(params: MultisineParams) -> MultisineParams:
    """The parameters with phases, by default Schroeder's; the lists must have one length.

    Raises:
        ConfigError: The lists are empty or differ in length.
    """
    count = len(params.amplitudes)
    phases = schroeder_phases(count) if params.phases is None else params.phases
    for name, values in (("frequencies", params.frequencies), ("phases", phases)):
        if not count or len(values) != count:
            raise ConfigError(name, f"must hold one number for each of the amplitudes, {count}, got {len(values)}")
    return params._replace(phases=phases)


MULTISINE = Reference(
    params=MultisineParams,
    at=multisine_at,
    prepare=prepare_multisine,
    level=lambda params: params.offset,
    last_change=lambda params: math.inf,  # its sines may add up at any time
)
