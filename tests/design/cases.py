"""Random bounds and free parameters that the tests of the theorem share."""

import numpy as np

from dssc_jax.core.zero_dynamics import ZeroDynamics
from dssc_jax.design import Bounds, Free

BOUNDS = Bounds(
    k_min=0.8, k_max=1.3, a_max=1.2, k_d1=0.05, k_d2=0.02, k_d3=0.1, k_d4=0.3, c_sigma=0.4, c_e2=0.2, y_m=20.0,
    y_m_dot=3.0, zero_dynamics=ZeroDynamics((1.0,), (0.2,)),
)  # fmt: skip
FREE = Free(l0=0.5, phi_a=0.1, eps=0.3, delta=0.5, eps_1=0.4, eps_2=0.1, eps_3=2.0)
NUMBERS = [name for name in Bounds._fields if name not in ("k_min", "k_max", "a_max", "zero_dynamics")]


def random_case(rng: np.random.Generator) -> tuple[Bounds, Free]:
    """Bounds over two decades and more, of order two or three, and free parameters that make a design of them."""
    k_min = 10 ** rng.uniform(-1, 1)
    numbers = {name: 10 ** rng.uniform(-2, 0.5) for name in NUMBERS}
    dynamics = ZeroDynamics((10 ** rng.uniform(-1, 1),), (rng.normal(),)) if rng.random() < 0.5 else None
    k_max = k_min * (1 + rng.uniform(0, 3))
    return Bounds(k_min, k_max, rng.uniform(0, 3), zero_dynamics=dynamics, **numbers), Free(
        *10 ** rng.uniform(-1.5, 0.7, 7)
    )
