"""Estimators of the vehicle's motion, which the controllers see in place of the true one: one file each."""

from typing import NamedTuple, Protocol, TypeVar

from dssc_jax.core.registry import Registry, single
from dssc_jax.core.signals import Scalar
from dssc_jax.models.uav.estimators.complementary import ComplementaryFilter
from dssc_jax.models.uav.estimators.kalman import KalmanFilter
from dssc_jax.models.uav.estimators.sensors import Motion, Random

M = TypeVar("M")


class Estimator(Protocol[M]):
    """Parameters of an estimator, with its functions; ``memory.estimate`` is the estimated :class:`Motion`."""

    def start(self, motion: Motion, random: Random) -> M:
        """The memory at t = 0.

        Args:
            motion: The true motion.
            random: Source of the random errors and biases.
        """
        ...

    def step(self, memory: M, motion: Motion, random: Random, k: Scalar, dt: float) -> M:
        """The memory after sample k.

        Args:
            memory: The memory after the sample before.
            motion: The true motion at the sample.
            random: Source of the sensors' noise.
            k: Index of the sample.
            dt: Length of a sample [s].
        """
        ...

    def nees(self, memory: M, motion: Motion) -> Scalar:
        """The squared error of the estimate, normalised by its covariance; 0 for an estimator without a covariance."""
        ...


class NoEstimator(NamedTuple):
    """The absence of an estimator: the controllers see the true state."""


ESTIMATORS: Registry = {
    "none": single(NoEstimator, "the controllers see the true state, through [sensor]"),
    "kalman": single(KalmanFilter, "error-state Kalman filter with 15 states"),
    "complementary": single(ComplementaryFilter, "complementary filter with constant gains"),
}
