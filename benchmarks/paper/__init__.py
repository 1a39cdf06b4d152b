"""Regenerate docs/paper.md and its figures, the article's Section V claim by claim: ``python -m benchmarks.paper``.

Every number of the page comes from here, with the machine and the date. Axes are x, y, z [m] and psi [rad].
"""

import dssc_jax  # noqa: F401  (sets compiler flags before anything starts JAX)
