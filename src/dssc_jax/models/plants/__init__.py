"""Registry of plants; a new one is one file and one row here."""

from dssc_jax.core.native.fmu_tables import KIND as FMU_KIND
from dssc_jax.core.registry import Registry, single
from dssc_jax.models.plants.fmu import FMU_PLANT
from dssc_jax.models.plants.linear import RATIONAL_PLANT, STATE_SPACE
from dssc_jax.models.plants.normal_form import NORMAL_FORM

PLANTS: Registry = {
    "normal_form": single(
        NORMAL_FORM, "x'' = -a_p x' - C_eta eta + k_p (u_p + d), any order (5)-(8)", initial=[1.0, 2.0]
    ),
    "state_space": single(
        STATE_SPACE,
        "x' = A x + b u_p + e d, y = c x",
        a=[[0.0, 1.0], [-2.0, -3.0]],
        b=[0.0, 1.0],
        c=[1.0, 0.0],
        x0=[1.0],
    ),
    "transfer_function": single(
        RATIONAL_PLANT, "y = G(s) (u_p + d), G strictly proper", numerator=[2.0, 1.0], denominator=[2.0, 1.0, 0.0, 3.0]
    ),
    FMU_KIND: FMU_PLANT,
}
