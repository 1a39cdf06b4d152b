"""Every tolerance of the tests, each with its reason."""

ROUNDING = 1e-12
"""Relative; a few hundred float64 operations."""

IDENTITY = 1e-10
"""Relative to |u_av| + |increment|: the implicit scheme's identities, for c spanning many decades."""

COMPILER = 1e-9
"""Relative, over seconds of an implicit loop: two compilers contract multiply-adds differently."""

SINGLE = 2e-3
"""Relative, float32 against float64 over 4 s: 400 samples of about 1e-7 each, times the loop's gain."""
