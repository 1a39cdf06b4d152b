"""Changes of the scores' law, and the density of the changed law relative to that of the draws.

The score of a number is the standard normal quantile at the level of its value. Together the scores of the draws have
the law N(0, R), with the correlations R of the Gaussian copula. A change has one amount for each number.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np


@dataclass(frozen=True)
class Change(ABC):
    """A family of changed laws of the scores.

    Args:
        precision: The inverse of the correlation matrix R, shape (numbers, numbers).
    """

    precision: np.ndarray

    name: ClassVar[str]
    """Name of the change in answers."""

    @abstractmethod
    def amount(self, size: float) -> float:
        """The size as answers state it: a shift in standard deviations, or a relative width."""

    @abstractmethod
    def limits(self, size: float) -> tuple[float, float]:
        """The range of each number's amount in a change of at most this size."""

    @abstractmethod
    def log_weights(self, amounts: np.ndarray, scores: np.ndarray) -> np.ndarray:
        """Logarithm of the changed density relative to that of the draws.

        Args:
            amounts: One for each number, shape (numbers,).
            scores: Shape (n, numbers).

        Returns:
            Shape (n,).
        """

    @abstractmethod
    def mean_slope(self, amounts: np.ndarray, scores: np.ndarray, shares: np.ndarray) -> np.ndarray:
        """Mean of the derivatives of :meth:`log_weights` with respect to the amounts.

        Args:
            amounts: Shape (numbers,).
            scores: Shape (n, numbers).
            shares: Share of each draw in the mean, with the sum 1, shape (n,).

        Returns:
            Shape (numbers,).
        """

    @abstractmethod
    def log_second_moment(self, amounts: np.ndarray) -> float:
        """Logarithm of the mean of the squared weights over the draws' law; infinite where that mean is."""

    @abstractmethod
    def corner(self, size: float, free: np.ndarray) -> float:
        """The largest :meth:`log_second_moment` of a change of at most this size of the free numbers, or more.

        Args:
            size: The size.
            free: Which numbers are changed, shape (numbers,).
        """

    @abstractmethod
    def changed(self, amounts: np.ndarray, scores: np.ndarray) -> np.ndarray:
        """Scores of the changed law from those of the draws' law, shape (n, numbers)."""


@dataclass(frozen=True)
class Shift(Change):
    """Every mean is shifted: the law is N(d, R), with the amounts d in standard deviations.

    ln w(c) = c' R^-1 d - d' R^-1 d / 2.
    """

    name = "mean_shift"

    def amount(self, size: float) -> float:
        """The size, in standard deviations."""
        return size

    def limits(self, size: float) -> tuple[float, float]:
        """Up or down."""
        return -size, size

    def log_weights(self, amounts: np.ndarray, scores: np.ndarray) -> np.ndarray:
        """See :class:`Change`."""
        weighted_amounts = self.precision @ amounts
        return scores @ weighted_amounts - 0.5 * amounts @ weighted_amounts

    def mean_slope(self, amounts: np.ndarray, scores: np.ndarray, shares: np.ndarray) -> np.ndarray:
        """See :class:`Change`."""
        return (shares @ scores - amounts) @ self.precision

    def log_second_moment(self, amounts: np.ndarray) -> float:
        """The logarithm d' R^-1 d."""
        return float(amounts @ self.precision @ amounts)

    def corner(self, size: float, free: np.ndarray) -> float:
        """The sum over all |R^-1| of the free numbers, times the squared size: exact without correlations."""
        return size**2 * float(np.abs(self.precision[np.ix_(free, free)]).sum())

    def changed(self, amounts: np.ndarray, scores: np.ndarray) -> np.ndarray:
        """See :class:`Change`."""
        return scores + amounts


@dataclass(frozen=True)
class Widening(Change):
    """Every width is multiplied: the law is N(0, D R D) with D = diag(exp(amounts)).

    With y = D^-1 c: ln w(c) = -sum(amounts) - (y' R^-1 y - c' R^-1 c) / 2.
    """

    name = "widening"

    def amount(self, size: float) -> float:
        """The relative width exp(size)."""
        return math.exp(size)

    def limits(self, size: float) -> tuple[float, float]:
        """Wider, never narrower."""
        return 0.0, size

    def log_weights(self, amounts: np.ndarray, scores: np.ndarray) -> np.ndarray:
        """See :class:`Change`."""
        shrunk = scores * np.exp(-amounts)
        return -amounts.sum() - 0.5 * (self._squares(shrunk) - self._squares(scores))

    def mean_slope(self, amounts: np.ndarray, scores: np.ndarray, shares: np.ndarray) -> np.ndarray:
        """See :class:`Change`."""
        shrunk = scores * np.exp(-amounts)
        moments = (shrunk * shares[:, None]).T @ shrunk
        return np.sum(self.precision * moments, axis=1) - 1.0

    def log_second_moment(self, amounts: np.ndarray) -> float:
        """Logarithm of det(D)^-2 det(2 D^-1 R^-1 D^-1 R - 1)^-1/2."""
        inverse = np.exp(-amounts)
        moment_precision = 2.0 * self.precision * np.outer(inverse, inverse) - self.precision
        if np.linalg.eigvalsh(moment_precision)[0] <= 0.0:
            return np.inf
        return float(-2.0 * amounts.sum() - 0.5 * (np.linalg.slogdet(moment_precision)[1] - self._log_determinant()))

    def corner(self, size: float, free: np.ndarray) -> float:
        """The logarithm for the same widening of all free numbers."""
        return self.log_second_moment(size * free)

    def changed(self, amounts: np.ndarray, scores: np.ndarray) -> np.ndarray:
        """See :class:`Change`."""
        return scores * np.exp(amounts)

    def _squares(self, scores: np.ndarray) -> np.ndarray:
        """c' R^-1 c of each row."""
        return np.einsum("ni,ni->n", scores @ self.precision, scores)

    def _log_determinant(self) -> float:
        return float(np.linalg.slogdet(self.precision)[1])
