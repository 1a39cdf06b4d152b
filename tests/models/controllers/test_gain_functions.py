"""Rows of the table against each other, against formulas worked out another way, and at sigma = 0."""

import jax
import numpy as np
import pytest

from dssc_jax.models.controllers.gain_functions import ApproximateSta1, ApproximateSta2, SquareRoot, StandardSta, Vgsta

POINTS = [(0.3, -0.2), (-2.0, 1.0), (1e-8, 0.5), (5.0, 0.0)]


@pytest.mark.parametrize(("sigma", "e"), POINTS)
def test_square_root_is_the_second_approximation(sigma, e):
    """With kappa1 = 2/(kappa_o tau_av), kappa2 = kappa1/kappa_m."""
    root = SquareRoot(110.651, 4.0166, 1.0, 1.0, 0.03)
    kappa1 = 2.0 / (110.651 * 0.03)
    row = ApproximateSta2(kappa1, kappa1 / 4.0166, 1.0, tau_av=0.03)
    np.testing.assert_allclose(row.at(sigma, e, 0.2), root.at(sigma, e, 0.2), rtol=1e-13)


@pytest.mark.parametrize(("sigma", "e"), POINTS)
def test_vgsta_row_obeys_23(sigma, e):
    """(23) with g_1 sigma = kappa_1 phi_1: derivatives by automatic differentiation, not by hand."""
    row = Vgsta(0.4, 1.5, 0.3, 0.2, 0.7, 0.5, 0.6, 0.8, 0.1, tau_av=0.05)
    l0 = 0.9

    def kappa_1(s, e):
        return (row.kappa_a * abs(s) + row.kappa_b * abs(e) + row.kappa_c) ** 2 + row.kappa_d

    def phi_1(s):
        return row.phi_a * s / (abs(s) ** 0.5 + row.delta) + row.phi_b * s

    def g1_sigma(s, e):
        return kappa_1(s, e) * phi_1(s)

    found = row.at(sigma, e, l0)
    inverse_product = jax.grad(g1_sigma, 0)(sigma, e)
    assert 1.0 / (found.k_o * found.tau_av) == pytest.approx(float(inverse_product), rel=1e-12)
    kappa_2 = 2 * row.epsilon * kappa_1(sigma, e) + row.gamma
    slope_e = jax.grad(g1_sigma, 1)(sigma, e) if e != 0 else 0.0  # sgn 0 = 0
    integral = slope_e * (sigma - l0 * e) + kappa_2 * phi_1(sigma) * jax.grad(phi_1)(sigma)
    assert sigma / (found.k_o * found.tau_av * found.tau_m) == pytest.approx(float(integral), rel=1e-12)


def test_first_approximation_obeys_23():
    """g_1 sigma = kappa1 phi_1 with phi_1' = 1/(2 (r + delta)), g_2 sigma = kappa2 phi_1 phi_1'."""
    row, sigma = ApproximateSta1(0.7, 1.9, 0.3, k_o=10.0), 0.8
    r = sigma**0.5
    phi_1 = r - 0.3 * np.log((r + 0.3) / 0.3)  # the integral of phi_1'
    found = row.at(sigma, 0.0, 1.0)
    product = found.k_o * found.tau_av
    assert 1 / product == pytest.approx(0.7 / (2 * (r + 0.3)), rel=1e-13)
    assert sigma / (product * found.tau_m) == pytest.approx(1.9 * phi_1 / (2 * (r + 0.3)), rel=1e-12)


def test_limits_at_zero():
    assert ApproximateSta1(1.0, 4.0, 0.5, k_o=1.0).at(0.0, 0.0, 1.0).tau_m == pytest.approx(2 * 0.5 / 4.0)
    stiff = StandardSta(1.0, 4.0, k_o=1.0).at(0.0, 0.0, 1.0)
    assert float(stiff.tau_m) == pytest.approx(1e-9 / 4.0)
    assert float(stiff.tau_av) > 0
