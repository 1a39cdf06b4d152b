"""A result as one HTML page that can be sent: no network, no JavaScript; and the index of many."""

from dssc_jax.report.index import write_index
from dssc_jax.report.page import html, write

__all__ = ["html", "write", "write_index"]
