"""The three sampled forms of the STA: accuracy in sliding, and how wrong the input gain may be."""

import numpy as np
import pytest

import dssc_jax as dj

OMEGA = 2 * np.pi / 5


def loop(form, h, k_p=1.0, k2=1.5, lipschitz=1.0):
    """sigma' = k_p (u + d) with |d'| <= lipschitz: a_p = l0 and no reference."""
    return dj.Study.from_table(
        {
            "name": "sta",
            "loop": {"duration": 20.0, "sample_time": h},
            "plant": {"kind": "normal_form", "k_p": k_p, "a_p": 1.0, "initial": [0.0, 0.1]},
            "controller": {"kind": "sta", "l0": 1.0, "kappa1": 2.0, "kappa2": 2 * k2, "discretisation": form},
            "disturbance": {"kind": "sine", "amplitude": lipschitz / OMEGA, "period": 5.0},
            "metrics": {"after": 10.0},
        }
    )


def residual(*args, **options):
    return dj.simulate(loop(*args, **options)).attrs["sigma_max"]


def test_proper_form_reaches_the_square_of_the_sample_time():
    found = {h: residual("proper", h) for h in (0.02, 0.01, 0.005)}
    print("\nproper: sup|sigma|/(L h^2)", {h: s / h**2 for h, s in found.items()})
    for h, s in found.items():
        assert s <= 1.01 * h**2
    assert found[0.02] / found[0.01] == pytest.approx(4.0, rel=0.01)
    assert found[0.01] / found[0.005] == pytest.approx(4.0, rel=0.01)


def test_implicit_form_is_of_first_order():
    found = {h: residual("implicit", h) for h in (0.02, 0.01, 0.005)}
    for h, s in found.items():
        assert s == pytest.approx(h / OMEGA, rel=1e-3)  # h sup|d|
    assert found[0.02] / found[0.01] == pytest.approx(2.0, rel=0.01)


@pytest.mark.parametrize(("form", "limit"), [("proper", 4 / 3), ("implicit", 2.0)])
def test_limit_of_the_input_gain(form, limit):
    """Just below the limit of k_p/k_n the command is as smooth as the disturbance; just above it chatters."""
    lower, upper = (dj.simulate(loop(form, 0.01, k_p=limit * factor)).attrs["command_tv"] for factor in (0.985, 1.015))
    smooth = 4 * (1 / OMEGA) * 2  # the disturbance's own variation over two periods
    print(f"\n{form}: total variation {lower:.2f} below k_p/k_n = {limit:.3f}, {upper:.2f} above")
    assert lower == pytest.approx(smooth, rel=0.02)
    assert upper > 1.5 * smooth


def test_explicit_form_chatters():
    assert dj.simulate(loop("explicit", 0.01)).attrs["command_tv"] > 1.5 * 8 / OMEGA


def test_limit_clips_the_command():
    study = loop("implicit", 0.01).override({"controller.limit": 0.3})
    assert dj.simulate(study).attrs["command_max"] == pytest.approx(0.3)


def test_vgsta_with_constant_gains_is_the_implicit_sta():
    """phi_b = delta = 0, kappa_1 = 2 constant, kappa_2 = 3: the same quadratic, another code path."""
    constant = {"phi_a": 1.0, "phi_b": 0.0, "kappa_a": 0.0, "kappa_b": 0.0, "kappa_c": 1.0, "kappa_d": 1.0}
    table = {"kind": "vgsta", "l0": 1.0, "epsilon": 0.5, "gamma": 1.0, **constant}
    sta = loop("implicit", 0.01)
    np.testing.assert_allclose(
        dj.simulate(sta.override({"controller": table}))["u"], dj.simulate(sta)["u"], rtol=1e-9, atol=1e-10
    )


def test_first_order_sliding_mode_does_not_chatter_when_implicit():
    study = loop("implicit", 0.01)
    smc = study.override({"controller": {"kind": "smc", "l0": 1.0, "gain": 2.0}})
    explicit = smc.override({"controller.discretisation": "explicit"})
    assert dj.simulate(smc).attrs["sigma_max"] < 0.011 / OMEGA
    assert dj.simulate(smc).attrs["command_tv"] < 7.0
    assert dj.simulate(explicit).attrs["command_tv"] > 1000.0
