"""Logged flights: read, replayed in the loop, compared with the draws, and turned into laws by a fit."""
