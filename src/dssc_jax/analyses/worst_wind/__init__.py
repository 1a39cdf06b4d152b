"""The worst wind within bounds for each signal of a flight, and many flights in given winds."""
