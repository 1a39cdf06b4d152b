"""Unmodelled dynamics in series with the plant input. A new one is one file and one row here."""

from dssc_jax.types import Registry, single
from dssc_jax.unmodelled.delay import DELAY
from dssc_jax.unmodelled.lag import LAG, NONE

UNMODELLED: Registry = {
    "none": single(NONE, "the command reaches the plant unchanged"),
    "lag": LAG,
    "delay": single(DELAY, "a pure delay of any real number of controller samples"),
}
