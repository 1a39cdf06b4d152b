"""How fast the engine is beside C, Numba, NumPy and its own plain form, on the same two loops: ``make bench``."""
