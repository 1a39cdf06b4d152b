"""The worst wind within bounds, and many flights in given winds."""
