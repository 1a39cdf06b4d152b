"""Correlated uncertain numbers: rank correlations from ``[correlation]``, realised by a Gaussian copula.

The table states Spearman's rank correlation of pairs of numbers. Each number keeps its own law, and numbers in no pair
remain independent.
"""

import math
from collections.abc import Collection, Mapping

import numpy as np

from dssc_jax.core.errors import ConfigError, nearest

LEAST_EIGENVALUE = 1e-8  # smaller eigenvalues of the correlation matrix count as 0


def normal_correlation(rank: float) -> float:
    """Linear correlation 2 sin(pi r/6) of two normal variables with the rank correlation r = ``rank``.

    Reference:
        K. Pearson, On Further Methods of Determining Correlation (1907).
    """
    return 2.0 * math.sin(math.pi * rank / 6.0)


def split_pair(pair: str) -> tuple[str, str]:
    """Split the key of a pair, such as ``"plant.k_p, plant.a_p"``, into its two names.

    Raises:
        ConfigError: The key does not have two different names.
    """
    names = [name.strip() for name in pair.split(",")]
    if len(names) != 2 or not all(names) or names[0] == names[1]:
        raise ConfigError(f'correlation."{pair}"', 'must name two different numbers, e.g. "plant.k_p, plant.a_p" = 0.5')
    return names[0], names[1]


def correlated_names(table: Mapping[str, float]) -> tuple[str, ...]:
    """Names of all numbers in the pairs of ``[correlation]``, each once, in the order of the table."""
    return tuple(dict.fromkeys(name for pair in table for name in split_pair(pair)))


def require_correlation(table: Mapping[str, float], laws: Collection[str], swept: Collection[str]) -> None:
    """Require that ``[correlation]`` is valid.

    Args:
        table: Rank correlation of each pair.
        laws: Names of the numbers with a law in the study file.
        swept: Names of the axes.

    Raises:
        ConfigError: A pair is malformed, has an unknown name or occurs twice, or the correlations are incompatible.
    """
    visited_pairs: set[frozenset[str]] = set()
    for pair, rank in table.items():
        place = f'correlation."{pair}"'
        names = split_pair(pair)
        for name in names:
            if name in swept:
                raise ConfigError(place, f"'{name}' is swept, and a swept number has no law; take the pair out")
            if name not in laws:
                rule = f"'{name}' is no uncertain number of this study; {nearest(name, laws)}"
                raise ConfigError(place, f"{rule}; where it has a number in place of its law, take the pair out")
        if frozenset(names) in visited_pairs:
            raise ConfigError(place, "this pair is given twice")
        visited_pairs.add(frozenset(names))
        if not -1.0 < rank < 1.0:
            raise ConfigError(place, f"a rank correlation must lie in (-1, 1), got {rank:g}")
    if table:
        require_positive_definite(table, correlated_names(table))


def correlation_matrix(table: Mapping[str, float], names: tuple[str, ...]) -> np.ndarray:
    """Correlation matrix of the normal variables of the copula, in the order of ``names``, shape (n, n)."""
    correlations = np.eye(len(names))
    for pair, rank in table.items():
        i, j = (names.index(name) for name in split_pair(pair))
        correlations[i, j] = correlations[j, i] = normal_correlation(rank)
    return correlations


def require_positive_definite(table: Mapping[str, float], names: tuple[str, ...]) -> None:
    """Require that the correlation matrix is positive definite.

    Raises:
        ConfigError: It is not; the message names the pair that lowers the smallest eigenvalue most.
    """
    correlations = correlation_matrix(table, names)
    values, vectors = np.linalg.eigh(correlations)
    if values[0] > LEAST_EIGENVALUE:
        return
    eigenvalue_shares = correlations * np.outer(vectors[:, 0], vectors[:, 0])

    def share(pair: str) -> float:
        a, b = split_pair(pair)
        return float(eigenvalue_shares[names.index(a), names.index(b)])

    worst_pair = min(table, key=share)
    raise ConfigError(
        f'correlation."{worst_pair}"',
        f"{table[worst_pair]:g} is incompatible with the other pairs: the correlation matrix is not positive definite "
        f"(smallest eigenvalue {values[0]:.2g})",
    )
