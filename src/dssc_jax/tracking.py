"""Tracking errors (9) and (10), which controllers, disturbances and metrics share."""

from typing import NamedTuple

from dssc_jax.types import Measurement, ReferencePoint, Scalar


class TrackingError(NamedTuple):
    """Output error e = y - y_m (9) [m] and the output of relative degree one sigma = e' + l_0 e (10) [m/s]."""

    e: Scalar
    sigma: Scalar


def tracking_error(measurement: Measurement, reference: ReferencePoint, l0: Scalar) -> TrackingError:
    """Equations (9) and (10)."""
    e = measurement.y - reference.y
    return TrackingError(e, measurement.y_dot - reference.y_dot + l0 * e)
