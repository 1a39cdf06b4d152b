"""The signals of one sample that metrics and formulas read."""

from typing import NamedTuple

from dssc_jax.core.signals import Info, ReferencePoint, Scalar


class Sample(NamedTuple):
    """The signals of one channel at a sample, for metrics. The output is y = e + ``reference.y``.

    Quantities without a unit have the units of the channel's output y and command u.

    Args:
        k: Index of the sample.
        dt: Sample time T_s [s].
        e: True output error.
        sigma: True sigma = e' + l_0 e.
        sigma_measured: Sigma as the controller sees it.
        u: Robust command.
        u_previous: Robust command of the previous sample; at the first sample, ``u``.
        u_total: Robust plus nominal command.
        k_p: Input gain of the draw's plant.
        info: Signals that the controller reports.
        reference: Desired output with its derivatives.
        e_dot: True derivative of the error.
        y_measured: Output as the controller sees it.
        y_dot_measured: Derivative of the output as the controller sees it.
    """

    k: Scalar
    dt: float
    e: Scalar
    sigma: Scalar
    sigma_measured: Scalar
    u: Scalar
    u_previous: Scalar
    u_total: Scalar
    k_p: Scalar
    info: Info
    reference: ReferencePoint = ReferencePoint(0.0, 0.0, 0.0)
    e_dot: Scalar = 0.0
    y_measured: Scalar = 0.0
    y_dot_measured: Scalar = 0.0


class Instant(NamedTuple):
    """The whole loop at one sample.

    Args:
        t: Time [s].
        dt: Sample time [s].
        channels: The sample of each channel.
        plant: Signals that the plant reports.
        measured: Readings of the measured signals.
    """

    t: Scalar
    dt: Scalar
    channels: tuple[Sample, ...]
    plant: Info
    measured: tuple[Scalar, ...] = ()
