"""Loops of the tests of proofs."""

import numpy as np

import dssc_jax as dj

LOOP = dj.Study.load("studies/certified_margin.toml").override(
    {"plant.k_p": 1.0, "plant.a_p": 0.3, "unmodelled.mu": 0.01, "requirement": [], "draws": 1}
)
CONSTANT = {"kind": "constant", "k_o": 5.0, "tau_av": 0.05, "tau_m": 0.5}
HIGHER = {"plant.zero_dynamics": {"a": [2.0, 1.5], "c": [0.3, 0.1]}}
SINE = {"kind": "sine", "amplitude": 0.2, "period": 2.0 * np.pi}
NOMINAL = {"controller.nominal": {"a": 0.8, "k": 1.1}}
TRANSFER = {"kind": "transfer_function", "mu": 0.02, "numerator": [1.0, -0.3, 0.2], "denominator": [1.0, 1.1, 0.9, 0.4]}
DIRECT = {"kind": "transfer_function", "mu": 0.03, "numerator": [2.0, 0.5], "denominator": [2.0, 1.5]}
