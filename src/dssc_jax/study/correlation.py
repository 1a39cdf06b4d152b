"""Correlated uncertain numbers: rank correlations from ``[correlation]``, realised by a Gaussian copula.

The table states Spearman's rank correlation of pairs of numbers. Each number keeps its own law. Numbers that are in no
pair remain independent.
"""

import math
from collections.abc import Collection, Mapping

import numpy as np

from dssc_jax.core.errors import ConfigError, nearest

LEAST_EIGENVALUE = 1e-8  # smaller eigenvalues of the correlation matrix count as 0


def normal_correlation(rank: float) -> float:
    """Linear correlation 2 sin(pi r/6) of two jointly normal variables whose rank correlation is r = ``rank``.

    The copula draws normal variables, for which only the linear correlation can be prescribed.

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
    names: list[str] = []
    for pair in table:
        names += split_pair(pair)
    return tuple(dict.fromkeys(names))


def require_correlation(table: Mapping[str, float], laws: Collection[str], swept: Collection[str]) -> None:
    """Require that ``[correlation]`` names pairs of uncertain numbers, each pair once, with consistent correlations.

    Args:
        table: Rank correlation of each pair, such as ``{"plant.k_p, plant.a_p": 0.5}``.
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
        require_positive_definite(table)


def correlation_matrix(table: Mapping[str, float], names: tuple[str, ...]) -> np.ndarray:
    """Matrix of the linear correlations of the copula's normal variables, in the order of ``names``, shape (n, n)."""
    correlations = np.eye(len(names))
    for pair, rank in table.items():
        first, second = split_pair(pair)
        i = names.index(first)
        j = names.index(second)
        correlations[i, j] = normal_correlation(rank)
        correlations[j, i] = correlations[i, j]
    return correlations


def require_positive_definite(table: Mapping[str, float]) -> None:
    """Require that the correlation matrix is positive definite, so that numbers with all these correlations exist.

    Raises:
        ConfigError: The matrix is not positive definite; the message names the pair that lowers the smallest eigenvalue
            most.
    """
    names = correlated_names(table)
    correlations = correlation_matrix(table, names)
    eigenvalues, eigenvectors = np.linalg.eigh(correlations)  # in rising order
    smallest = eigenvalues[0]
    if smallest > LEAST_EIGENVALUE:
        return
    v = eigenvectors[:, 0]
    shares = correlations * np.outer(v, v)  # share v_i R_ij v_j of each entry in the eigenvalue v^T R v

    def share_of_eigenvalue(pair: str) -> float:
        """Contribution of a pair's correlation to the smallest eigenvalue."""
        first, second = split_pair(pair)
        return float(shares[names.index(first), names.index(second)])

    worst_pair = min(table, key=share_of_eigenvalue)
    raise ConfigError(
        f'correlation."{worst_pair}"',
        f"{table[worst_pair]:g} is incompatible with the other pairs: the correlation matrix is not positive definite "
        f"(smallest eigenvalue {smallest:.2g})",
    )
