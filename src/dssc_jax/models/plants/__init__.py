"""Registry of plants; a new one is one file and one row here."""

from dssc_jax.core.registry import Registry, single
from dssc_jax.models.plants.linear import RATIONAL_PLANT, STATE_SPACE
from dssc_jax.models.plants.normal_form import NORMAL_FORM

PLANTS: Registry = {
    "normal_form": single(NORMAL_FORM, "x'' = -a_p x' - C_eta eta + k_p (u_p + d), any order (5)-(8)"),
    "state_space": single(STATE_SPACE, "x' = A x + b u_p + e d, y = c x"),
    "transfer_function": single(RATIONAL_PLANT, "y = G(s) (u_p + d), G strictly proper"),
}
