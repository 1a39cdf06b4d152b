"""Write a result as one self-contained HTML page, without network or JavaScript, and an index of many results."""

from dssc_jax.report.index import write_index
from dssc_jax.report.page import html, write

__all__ = ["html", "write", "write_index"]
