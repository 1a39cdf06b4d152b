"""Linearised only where there is a derivative: corners, quantisers, switching laws, and parts that declare nothing."""

import sys

import control
import numpy as np
import pytest
from scipy.linalg import expm

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.smoothness import SMOOTH, declared_smoothness
from dssc_jax.engine.linearisation.smooth_parts import declared_places, substitute_notes
from dssc_jax.models.actuators import UNMODELLED
from dssc_jax.models.actuators.lag import LAG, Order
from dssc_jax.models.controllers import CONTROLLERS
from dssc_jax.models.controllers.gain_functions import GAIN_FUNCTIONS
from dssc_jax.models.differentiators import DIFFERENTIATORS
from dssc_jax.models.disturbances import DISTURBANCES
from dssc_jax.models.plants import PLANTS
from dssc_jax.models.sensors import SENSORS

SAMPLE_TIME, K_P, K_I = 0.1, 10.290658464501297, 9.818466253345544
PID = {"kind": "pid", "k_p": K_P, "k_i": K_I}
DUTY = {
    "name": "duty",
    "draws": 1,
    "loop": {"duration": 2.0, "sample_time": SAMPLE_TIME, "substeps": 20},
    "plant": {"kind": "transfer_function", "numerator": [1.0], "denominator": [0.07, 1.07, 1.0]},
    "controller": PID | {"low": 0.0, "high": 1.0},
}
"""1/((s + 1)(0.07 s + 1)) under PI with a duty cycle in [0, 1], at rest at 0: on the corner of the clip."""


def margins_of(table, **options):
    """Gain margin, phase margin [deg] and what was taken."""
    found = dj.loop_margins(dj.Study.from_table(table), **options)
    margins = found.statistics(found.points[0], "input").margins
    return margins["gain_upper"].worst, np.degrees(margins["phase"].worst), found.taken


def margins_by_hand():
    """Of the loop within its limits: the plant by a matrix exponential, PI with the integral one sample late."""
    a, b = np.array([[-1.0, 1.0], [0.0, -1.0 / 0.07]]), np.array([0.0, 1.0 / 0.07])
    held = expm(SAMPLE_TIME * np.block([[a, b[:, None]], [np.zeros((1, 3))]]))
    plant = control.ss(held[:2, :2], held[:2, 2:], [[1.0, 0.0]], 0.0, SAMPLE_TIME)
    law = control.ss([[1.0]], [[SAMPLE_TIME * K_I]], [[1.0]], [[K_P]], SAMPLE_TIME)
    return control.stability_margins(control.series(law, plant))[:2]


def test_a_command_limit_at_the_equilibrium_has_the_margins_of_the_loop_within_it():
    """2.71 and 37 degrees; half the gain, which is a clip's derivative at its corner under JAX, has 5.5 and 64."""
    gain, phase, taken = margins_of(DUTY)
    expected = margins_by_hand()
    assert expected == pytest.approx((2.71, 37.0), abs=1e-6)
    assert (gain, phase) == pytest.approx(expected, rel=1e-5)
    assert len(taken) == 1
    assert "'pid' lies on the limits low and high of its command; there it counts as within them" in taken[0]
    assert "1 of 1 draws" in taken[0]


def test_limits_away_from_the_equilibrium_are_not_mentioned():
    gain, phase, taken = margins_of(DUTY | {"controller": PID | {"low": -1.0, "high": 1.0}})
    assert (gain, phase) == pytest.approx(margins_by_hand(), rel=1e-5)
    assert taken == ()


def test_draws_on_the_corner_and_draws_within_are_told_apart():
    law = {"low": {"truncated_normal": [-0.2, 0.5, -0.6, 0.0]}}
    sampled = DUTY | {"draws": 8, "controller": PID | {"high": 1.0} | law}
    assert margins_of(sampled)[2] == ()
    feedback = {"kind": "state_feedback", "k_1": K_P, "k_2": 0.0, "k_i": K_I, "high": 0.0}
    gain, phase, taken = margins_of(DUTY | {"draws": 3, "controller": feedback})
    assert (gain, phase) == pytest.approx(margins_by_hand(), rel=1e-5)
    assert "3 of 3 draws" in taken[0]


QUANTISED = [
    (
        {"unmodelled": {"kind": "quantisation", "resolution": 0.02}},
        "unmodelled 'quantisation' counts as its mean gain 1",
    ),
    (
        {"sensor": {"kind": "noisy", "position_resolution": 0.02}},
        "sensor 'noisy' counts its resolution as its mean gain",
    ),
]


@pytest.mark.parametrize(("change", "text"), QUANTISED)
def test_a_quantiser_counts_as_its_mean_gain(change, text):
    gain, phase, taken = margins_of(DUTY | {"controller": PID} | change)
    assert (gain, phase) == pytest.approx(margins_by_hand(), rel=1e-5)
    assert text in taken[0]
    assert "4/pi" in taken[0]


@pytest.mark.parametrize("change", [change for change, _ in QUANTISED])
def test_local_margins_see_the_loop_behind_a_quantiser(change):
    """Its derivative 0 would open the loop, which passes every draw; the integrating plant needs a gain margin."""
    table = {
        "name": "local",
        "draws": 3,
        "loop": {"duration": 1.0, "sample_time": 0.05},
        "plant": {"kind": "normal_form", "k_p": {"uniform": [0.8, 1.2]}, "a_p": 1.0},
        "controller": {"kind": "pi", "l0": 1.0, "k_p": 2.0, "k_i": 1.0},
    }
    walk = {"over": "controller.k_p", "bounds": (1.0, 100.0), "log": True, "points": 5, "bisections": 12}
    plain = dj.theory.local_margin(dj.Study.from_table(table), **walk)
    found = dj.theory.local_margin(dj.Study.from_table(table | change), **walk)
    np.testing.assert_array_equal(found.dataset["critical"], plain.dataset["critical"])
    assert plain.summary()["pass_to_end"] == 0.0
    assert any("mean gain 1" in text for text in found.criterion)


def test_a_command_limit_at_the_origin_does_not_open_the_loop_of_a_local_margin():
    walk = {"over": "controller.k_p", "bounds": (5.0, 100.0), "log": True, "points": 4, "bisections": 12}
    limited = dj.theory.local_margin(dj.Study.from_table(DUTY), **walk)
    plain = dj.theory.local_margin(dj.Study.from_table(DUTY | {"controller": PID}), **walk)
    np.testing.assert_allclose(limited.dataset["critical"], plain.dataset["critical"], rtol=1e-12)
    assert plain.dataset["critical"].item() == pytest.approx(K_P * 2.71, rel=0.1)
    assert any("lies on the limits" in text for text in limited.criterion)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"controller": {"kind": "smc", "l0": 1.0, "gain": 1.0}}, "'smc' switches at the origin"),
        ({"controller": {"kind": "sta", "l0": 1.0, "kappa1": 1.0, "kappa2": 1.0}}, "'sta' switches at the origin"),
        ({"sensor": {"kind": "noisy", "loss": 0.1}}, "loses readings at random"),
        ({"sensor": {"kind": "noisy", "period_samples": 2.0}}, "must be 1 for a frequency response"),
    ],
)
def test_parts_without_a_linearisation_are_refused_by_name(change, text):
    for ask in (dj.loop_margins, local_margin_of):
        with pytest.raises(ConfigError, match=text):
            ask(dj.Study.from_table(DUTY | change))


def local_margin_of(study):
    return dj.theory.local_margin(study, over="controller.l0", bounds=(1.0, 2.0), points=2, bisections=1)


@pytest.mark.parametrize(
    "registry", [CONTROLLERS, DIFFERENTIATORS, SENSORS, DISTURBANCES, PLANTS, UNMODELLED, GAIN_FUNCTIONS]
)
def test_every_part_of_the_package_declares_where_it_is_smooth(registry):
    for kind, entry in registry.items():
        for part in entry.members.values():
            assert part.smooth is not None, kind


def test_stated_values_are_named_once():
    change = {"unmodelled": {"kind": "quantisation", "resolution": 0.02}, "differentiator": {"kind": "levant"}}
    change["differentiator"]["lipschitz"] = 3.0
    lines = substitute_notes(declared_places(dj.Study.from_table(DUTY | change), moving=False))
    assert [line.partition(" counts")[0] for line in lines] == ["differentiator 'levant'", "unmodelled 'quantisation'"]


UNDECLARED = """
from typing import Annotated, NamedTuple
import jax.numpy as jnp
from dssc_jax.types import *
class Gains(NamedTuple):
    l0: Annotated[float, Quantity("1/s", "error pole", above=0.0)]
class Info(NamedTuple):
    spring: float
def stepping(law):
    def step(gains, state, measurement, reference, dt):
        u = law(-3.0 * measurement.y - measurement.y_dot)
        return state, Command(u, 0.0), Info(u)
    return step
def controller(law, **declared):
    return Controller(Gains, lambda gains, measurement, reference: (), stepping(law), **declared)
SILENT = controller(lambda v: v)
HONEST = controller(lambda v: v, smooth=SMOOTH)
WRONG = controller(lambda v: v, smooth=True)
STAIRS = controller(lambda v: 0.25 * jnp.round(v / 0.25), smooth=SMOOTH)
DEAD = controller(lambda v: v - jnp.clip(v, -0.1, 0.1), smooth=SMOOTH)
CLIPPED = controller(lambda v: jnp.clip(v, 0.0, 1.0), smooth=SMOOTH)
KINKED = controller(lambda v: v + 0.02 * jnp.abs(v), smooth=SMOOTH)
SWITCHED = controller(lambda v: v + 1e-3 * jnp.sign(v), smooth=SMOOTH)
CUBIC = controller(lambda v: v**3 - v * jnp.abs(v) + v * jnp.sqrt(jnp.abs(v) + 1e-300), smooth=SMOOTH)
"""


@pytest.fixture
def own_parts(tmp_path, monkeypatch):
    """A module of controllers of one's own."""
    (tmp_path / "undeclared_parts.py").write_text(UNDECLARED)
    monkeypatch.syspath_prepend(tmp_path)
    yield (
        lambda name: (
            DUTY
            | {
                "plant": {"kind": "normal_form"},
                "controller": {"kind": f"undeclared_parts:{name}", "l0": 1.0},
            }
        )
    )
    sys.modules.pop("undeclared_parts", None)


def test_a_part_of_ones_own_that_declares_nothing_is_refused_with_the_field_to_set(own_parts):
    for ask in (dj.loop_margins, local_margin_of):
        with pytest.raises(ConfigError, match="set the field smooth of the Controller: smooth=SMOOTH if") as caught:
            ask(dj.Study.from_table(own_parts("SILENT")))
        assert "'undeclared_parts:SILENT' does not declare where it is smooth" in str(caught.value)
        assert "controller.kind" in str(caught.value)
    assert margins_of(own_parts("HONEST"))[2] == ()
    with pytest.raises(ConfigError, match="must declare a Smoothness in its field smooth, such as SMOOTH, got True"):
        dj.loop_margins(dj.Study.from_table(own_parts("WRONG")))


@pytest.mark.parametrize("name", ["STAIRS", "DEAD", "CLIPPED", "KINKED", "SWITCHED"])
def test_a_false_declaration_is_caught(own_parts, name):
    with pytest.raises(ConfigError, match="declares that it is smooth, but at 1 of 1 operating points"):
        dj.loop_margins(dj.Study.from_table(own_parts(name)))
    if name in ("STAIRS", "CLIPPED"):
        with pytest.raises(ConfigError, match="declares that it is smooth"):
            dj.theory.local_margin(
                dj.Study.from_table(own_parts(name)), over="plant.k_p", bounds=(1.0, 2.0), points=2, bisections=1
            )


def test_powers_and_roots_times_their_argument_are_smooth(own_parts):
    dj.theory.local_margin(
        dj.Study.from_table(own_parts("CUBIC")), over="plant.k_p", bounds=(1.0, 2.0), points=2, bisections=1
    )


def test_a_declaration_may_follow_from_the_parameters():
    part = LAG.members[Order.ONE]._replace(smooth=lambda own: SMOOTH if own == 1 else None)
    assert declared_smoothness(part, 1) is SMOOTH
    with pytest.raises(ConfigError, match="does not declare where it is smooth"):
        declared_smoothness(part, 2)
