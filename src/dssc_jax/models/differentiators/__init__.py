"""Registry of differentiators, which estimate y' from sampled y; a new one is one file and one row here.

Each starts at the first y with velocity zero and ignores the velocity of the first measurement, because only y is
known. A step estimates y' at the current sample. After its transient each gives the exact y' of y = c0 + c1 t, and each
is stable at every dt. A y that is an angle must be continuous, without jumps by a turn.
"""

from dssc_jax.core.contracts import Differentiator, NoParams
from dssc_jax.core.default_functions import always
from dssc_jax.core.registry import Registry, single
from dssc_jax.core.smoothness import SMOOTH
from dssc_jax.models.differentiators.high_gain_observer import HIGH_GAIN_OBSERVER
from dssc_jax.models.differentiators.lead_filter import LEAD_FILTER
from dssc_jax.models.differentiators.levant import LEVANT

NO_DIFFERENTIATOR = Differentiator(
    NoParams,
    init=lambda params, measurement: (),
    step=lambda params, state, measurement, dt: (state, measurement),
    smooth=SMOOTH,
    transparent=always,
)

DIFFERENTIATORS: Registry = {
    "none": single(NO_DIFFERENTIATOR, "the measured velocity"),
    "lead_filter": single(LEAD_FILTER, "s y/(tau_f s + 1), exact for y linear between samples", tau_f=0.02),
    "high_gain_observer": single(
        HIGH_GAIN_OBSERVER, "two estimates with poles of order 1/epsilon, backward Euler", epsilon=0.02
    ),
    "levant": single(LEVANT, "robust exact differentiator of first order, implicit: no chatter", lipschitz=20.0),
}
