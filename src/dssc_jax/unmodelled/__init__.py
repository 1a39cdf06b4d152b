"""Unmodelled dynamics in series with the plant input. A new one is one file and one row here."""

from dssc_jax.types import Registry, single
from dssc_jax.unmodelled.delay import DELAY
from dssc_jax.unmodelled.lag import LAG, NONE
from dssc_jax.unmodelled.rate_limit import RATE_LIMIT
from dssc_jax.unmodelled.saturation import SATURATION
from dssc_jax.unmodelled.transfer_function import TRANSFER_FUNCTION

UNMODELLED: Registry = {
    "none": single(NONE, "the command reaches the plant unchanged"),
    "lag": LAG,
    "transfer_function": single(TRANSFER_FUNCTION, "any stable proper G(mu s) with G(0) = 1, of order 1 to 6"),
    "delay": single(DELAY, "a pure delay of any real number of controller samples"),
    "rate_limit": single(RATE_LIMIT, "a plant input that follows the command at a limited rate"),
    "saturation": single(SATURATION, "a plant input of limited magnitude"),
}
