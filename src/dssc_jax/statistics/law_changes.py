"""Changes of the law of the scores, and the density of the changed law relative to the law of the draws.

The score c of a number is the standard normal quantile at the level of its value. Together the scores of a draw have
the law N(0, R), with the correlation matrix R of the Gaussian copula. A change has an amount for each number.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np


@dataclass(frozen=True)
class Change(ABC):
    """A family of changed laws of the scores, such as all shifted laws.

    Each member has one amount of change per number. The size of a member is its largest amount.

    Args:
        precision: Inverse of the correlation matrix R, shape (numbers, numbers).
    """

    precision: np.ndarray

    name: ClassVar[str]
    """Name of the family in answers."""

    @abstractmethod
    def amount(self, size: float) -> float:
        """The size of a change in the unit of answers: a shift in standard deviations, or a relative width."""

    @abstractmethod
    def limits(self, size: float) -> tuple[float, float]:
        """Least and greatest amount of each number in a change of at most this size."""

    @abstractmethod
    def log_weights(self, amounts: np.ndarray, scores: np.ndarray) -> np.ndarray:
        """Logarithm of each draw's importance weight: the changed density of the draw over its present density.

        Args:
            amounts: Amount of the change of each number, shape (numbers,).
            scores: Scores of the draws, shape (n, numbers).

        Returns:
            Shape (n,).
        """

    @abstractmethod
    def mean_slope(self, amounts: np.ndarray, scores: np.ndarray, shares: np.ndarray) -> np.ndarray:
        """Weighted mean over the draws of the gradient of :meth:`log_weights` in the amounts.

        Args:
            amounts: Amount of the change of each number, shape (numbers,).
            scores: Scores of the draws, shape (n, numbers).
            shares: Share of each draw in the mean, with the sum 1, shape (n,).

        Returns:
            Shape (numbers,).
        """

    @abstractmethod
    def log_second_moment(self, amounts: np.ndarray) -> float:
        """Logarithm of the mean squared weight under the unchanged law, shape (); infinite if the mean is infinite.

        The mean squared weight tells how uneven the weights are: n draws are worth n/(mean squared weight) draws of the
        changed law.

        Args:
            amounts: Amount of the change of each number, shape (numbers,).
        """

    @abstractmethod
    def log_second_moment_bound(self, size: float, free: np.ndarray) -> float:
        """Upper bound of :meth:`log_second_moment` over all changes of at most this size.

        Args:
            size: Largest amount.
            free: Which numbers change, bool of shape (numbers,).
        """

    @abstractmethod
    def apply(self, amounts: np.ndarray, scores: np.ndarray) -> np.ndarray:
        """Turn scores of draws into scores under the changed law, shape (n, numbers).

        Args:
            amounts: Amount of the change of each number, shape (numbers,).
            scores: Scores under the unchanged law, shape (n, numbers).
        """


@dataclass(frozen=True)
class Shift(Change):
    """Shifted means: the law N(d, R), with the amounts d in standard deviations.

    The importance weight of a draw with the scores c has the logarithm c' R^-1 d - d' R^-1 d / 2.
    """

    name = "mean_shift"

    def amount(self, size: float) -> float:
        """Largest shift of a mean, in standard deviations."""
        return size

    def limits(self, size: float) -> tuple[float, float]:
        """Least and greatest shift of each mean [standard deviations]: a mean may move up or down by the size."""
        return -size, size

    def log_weights(self, amounts: np.ndarray, scores: np.ndarray) -> np.ndarray:
        """Logarithm c' R^-1 d - d' R^-1 d / 2 of each draw's importance weight, shape (n,)."""
        weighted_amounts = self.precision @ amounts
        return scores @ weighted_amounts - 0.5 * amounts @ weighted_amounts

    def mean_slope(self, amounts: np.ndarray, scores: np.ndarray, shares: np.ndarray) -> np.ndarray:
        """Weighted mean of the gradient R^-1 (c - d) in the amounts, shape (numbers,)."""
        return (shares @ scores - amounts) @ self.precision

    def log_second_moment(self, amounts: np.ndarray) -> float:
        """Logarithm d' R^-1 d of the mean squared weight."""
        return float(amounts @ self.precision @ amounts)

    def log_second_moment_bound(self, size: float, free: np.ndarray) -> float:
        """Upper bound of d' R^-1 d over all shifts d of the free numbers with |d_i| <= size.

        d' R^-1 d is the logarithm of the mean squared weight. The bound is the squared size times the sum of |entry|
        over the entries of R^-1 that belong to the free numbers.

        Args:
            size: Largest shift [standard deviations].
            free: Whether the law of each number may change, shape (numbers,).
        """
        return size**2 * float(np.abs(self.precision[np.ix_(free, free)]).sum())

    def apply(self, amounts: np.ndarray, scores: np.ndarray) -> np.ndarray:
        """Add the amounts to the scores."""
        return scores + amounts


@dataclass(frozen=True)
class Widening(Change):
    """Multiplied widths: the law N(0, D R D) with D = diag(exp(amounts)).

    The importance weight of a draw with the scores c has the logarithm -sum(amounts) - (y' R^-1 y - c' R^-1 c) / 2,
    where y = D^-1 c.
    """

    name = "widening"

    def amount(self, size: float) -> float:
        """Largest relative width exp(size)."""
        return math.exp(size)

    def limits(self, size: float) -> tuple[float, float]:
        """Least and greatest amount of each number: a law may become wider (amount > 0), and never narrower."""
        return 0.0, size

    def log_weights(self, amounts: np.ndarray, scores: np.ndarray) -> np.ndarray:
        """Logarithm of each draw's importance weight, shape (n,), by the formula of the class."""
        shrunk = scores * np.exp(-amounts)  # y
        return -amounts.sum() - 0.5 * (self._squares(shrunk) - self._squares(scores))

    def mean_slope(self, amounts: np.ndarray, scores: np.ndarray, shares: np.ndarray) -> np.ndarray:
        """Weighted mean of the gradient in the amounts, diag(y) R^-1 y - 1 with y = D^-1 c, shape (numbers,)."""
        shrunk = scores * np.exp(-amounts)  # y
        moments = (shrunk * shares[:, None]).T @ shrunk  # weighted mean of y y'
        return np.sum(self.precision * moments, axis=1) - 1.0

    def log_second_moment(self, amounts: np.ndarray) -> float:
        """Logarithm of the mean squared weight det(D)^-2 det(2 D^-1 R^-1 D^-1 R - 1)^-1/2.

        The mean is an integral of a normal density with the precision 2 D^-1 R^-1 D^-1 - R^-1. If this matrix is not
        positive definite, the mean is infinite.

        Args:
            amounts: Amount of the change of each number, shape (numbers,); D = diag(exp(amounts)).
        """
        inverse_widths = np.exp(-amounts)
        moment_precision = 2.0 * self.precision * np.outer(inverse_widths, inverse_widths) - self.precision
        smallest_eigenvalue = np.linalg.eigvalsh(moment_precision)[0]
        if smallest_eigenvalue <= 0.0:
            return np.inf
        log_determinant_ratio = np.linalg.slogdet(moment_precision)[1] - np.linalg.slogdet(self.precision)[1]
        return float(-2.0 * amounts.sum() - 0.5 * log_determinant_ratio)

    def log_second_moment_bound(self, size: float, free: np.ndarray) -> float:
        """Logarithm of the mean squared weight at the largest widening of all free numbers.

        No other widening of at most this size has a larger mean squared weight.
        """
        return self.log_second_moment(size * free)

    def apply(self, amounts: np.ndarray, scores: np.ndarray) -> np.ndarray:
        """Multiply the scores by the relative widths exp(amounts)."""
        return scores * np.exp(amounts)

    def _squares(self, scores: np.ndarray) -> np.ndarray:
        """Quadratic form c' R^-1 c of each row c, shape (n,)."""
        return np.einsum("ni,ni->n", scores @ self.precision, scores)
