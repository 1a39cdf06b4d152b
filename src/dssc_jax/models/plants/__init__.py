"""Registry of plants; a new one is one file and one row here."""

from dssc_jax.core.registry import Registry, single
from dssc_jax.models.plants.normal_form import NORMAL_FORM

PLANTS: Registry = {
    "normal_form": single(NORMAL_FORM, "x'' = -a_p x' - C_eta eta + k_p (u_p + d), any order (5)-(8)"),
}
