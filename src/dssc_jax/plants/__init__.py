"""Plants. A new one is one file and one row here."""

from dssc_jax.plants.normal_form import NORMAL_FORM
from dssc_jax.types import Registry, single

PLANTS: Registry = {
    "normal_form": single(NORMAL_FORM, "x'' = -a_p x' - C_eta eta + k_p (u_p + d), any order (5)-(8)"),
}
