"""``[[actuator]]``: names of its numbers, its refusals, and every analysis of a chain: right, or refused by name."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.analyses.theory.chattering import time_constant_of
from dssc_jax.analyses.theory.local import Time
from dssc_jax.core.errors import ConfigError
from dssc_jax.design.certification import NotCovered, reach
from dssc_jax.engine.linearisation.smooth_parts import declared_places
from dssc_jax.exploration.sliders import sliders_of
from dssc_jax.models.actuators.backlash import BACKLASH
from dssc_jax.proofs.coverage import problem_of
from dssc_jax.report.diagram import diagram_text
from tests.conftest import UNCERTAIN

BUS = {"kind": "delay", "samples": 2.0, "memory": 4}
SERVO = {"name": "servo", "kind": "lag", "mu": {"loguniform": [0.01, 0.04]}}
LIMIT = {"kind": "saturation", "limit": 2.0}
TABLE = {name: value for name, value in UNCERTAIN.items() if name not in ("unmodelled", "sweep")}


LAG = {"kind": "lag", "mu": 0.02}
BOTH = BACKLASH._replace(held=False)


def chained(*actuators, **changes):
    return dj.Study.from_table(TABLE | {"actuator": list(actuators)} | changes)


def test_numbers_have_the_label_or_the_index_of_their_element():
    study = chained(BUS, SERVO)
    assert [name for name in study.numbers if name.startswith("actuator.")] == [
        "actuator.0.samples",
        "actuator.0.memory",
        "actuator.servo.mu",
    ]
    assert study.numbers["actuator.servo.mu"].paths == ("unmodelled.0.1.mu",)
    by_label, by_index = (study.override({name: 0.03}) for name in ("actuator.servo.mu", "actuator.1.mu"))
    assert by_label.hash == by_index.hash
    assert by_label.numbers["actuator.servo.mu"].value == 0.03
    assert "actuator.servo.mu" in study.laws
    swept = study.override({"sweep": {"actuator.servo.mu": [0.01, 0.1], "actuator.0.samples": [0.0, 3.5]}})
    assert set(swept.axes) == {"actuator.servo.mu", "actuator.0.samples"}
    assert "actuator.0.samples" in [slider.name for slider in sliders_of(study)]
    assert "unmodelled delay + lag" in diagram_text(study)
    assert "delay + lag" in str(study)


def test_a_sweep_checks_the_element_that_it_moves():
    with pytest.raises(ConfigError, match=r"sweep: actuator.0.samples: must be <= memory = 4, got up to 9"):
        chained(BUS, SERVO, sweep={"actuator.0.samples": [1.0, 9.0]})


def test_a_chain_of_one_element_is_that_element():
    alone, chain = dj.Study.from_table(TABLE | {"unmodelled": BUS}), chained(BUS, {"kind": "none"})
    assert chain.loop == alone.loop
    assert chain.template == alone.template
    assert chained().loop.unmodelled == chained({"kind": "none"}).loop.unmodelled


def test_both_forms_have_the_same_draws():
    lag = {"kind": "lag", "order": 2, "mu": 0.02}
    alone = dj.run(dj.Study.from_table(TABLE | {"unmodelled": lag, "draws": 4}), check=False)
    chain = dj.run(chained({"kind": "lag", "mu": 0.02}, {"kind": "lag", "mu": 0.02}, draws=4), check=False)
    np.testing.assert_allclose(chain.dataset["error_max"], alone.dataset["error_max"], rtol=1e-9)


@pytest.mark.parametrize(
    ("actuators", "message"),
    [
        ([BUS | {"smples": 1.0}], r"actuator.0.smples: unknown name; did you mean 'samples'\?"),
        ([{"mu": 0.1}], "actuator.0.kind: is required and missing"),
        ([SERVO, SERVO], "actuator.1.name: 'servo' names two elements"),
        ([SERVO | {"name": "0"}], "actuator.0.name: string should match pattern .* got '0'"),
        ([SERVO | {"channel": "x"}], "actuator.servo.channel: must be a channel of the plant, got 'x'"),
        (
            [SERVO, {"kind": "lost_command", "probability": 0.1}],
            "actuator.1.kind: 'lost_command' acts on the sampled command; place it before 'lag'",
        ),
        (
            [{"kind": "tests.study.test_actuators:BOTH", "half_width": 0.1}, LAG],
            "actuator.0.kind: 'tests.study.test_actuators:BOTH' acts at the samples and between them; it stands alone",
        ),
        ([BUS] * 13, "actuator: has at most 12 elements, got 13"),
    ],
)
def test_bad_chains_are_told_in_one_line(actuators, message):
    with pytest.raises(ConfigError, match=message) as caught:
        chained(*actuators)
    assert "\n" not in str(caught.value)


def test_a_chain_stands_alone():
    with pytest.raises(ConfigError, match="unmodelled: is the chain of one element; beside"):
        chained(BUS, unmodelled=SERVO | {"mu": 0.1})
    with pytest.raises(ConfigError, match=r"actuator: is a list of tables: write \[\[actuator\]\]"):
        dj.Study.from_table(TABLE | {"actuator": BUS})


CHANNEL = {
    "name": "chain",
    "loop": {"duration": 1.0, "sample_time": 0.01},
    "plant": {"kind": "normal_form", "k_p": 1.3, "a_p": 0.8},
    "controller": {"kind": "pi", "l0": 4.0, "k_p": 10.0, "k_i": 5.0},
}


def margins(*actuators):
    found = dj.loop_margins(dj.Study.from_table(CHANNEL | {"actuator": list(actuators)}))
    return found.summary()["loops"]["input"]["gain_upper"]["median"], found


def test_elements_without_a_derivative_count_as_they_declare():
    """Several at once: the linear part decides, and the notes name each element."""
    expected, _ = margins(LAG, LAG)
    rounding = {"kind": "quantisation", "resolution": 0.1}
    play = {"kind": "backlash", "half_width": 0.1}
    zone = {"kind": "dead_zone", "half_width": 0.1}
    found, answer = margins(zone, rounding, LAG, LIMIT, play, LAG)
    assert found == pytest.approx(expected, rel=2e-5)  # of the steps between the lags
    text = str(answer.summary())
    for kind in ("dead_zone", "quantisation", "backlash"):
        assert f"contains '{kind}', which counts as" in text


def test_limits_within_a_chain_are_left_out_at_their_corner():
    """A rate limit at rest lies on its boundary, within a chain as alone."""
    expected, _ = margins(LAG, LAG)
    assert margins(LAG, {"kind": "rate_limit", "rate": 5.0}, LAG)[0] == pytest.approx(expected, rel=2e-5)


def test_random_losses_have_no_linearisation():
    study = dj.Study.from_table(CHANNEL | {"actuator": [{"kind": "lost_command", "probability": 0.1}, LAG]})
    with pytest.raises(ConfigError, match="contains 'lost_command', which loses commands at random"):
        declared_places(study, moving=False)


def test_theory_of_a_chain():
    """The continuous-time edge of two lags is that of a lag of order 2; a delay is refused by its chain's name."""
    walk = {"over": "controller.k_p", "bounds": (5.0, 500.0), "log": True, "points": 5, "bisections": 20}
    alone = CHANNEL | {"unmodelled": {"kind": "lag", "order": 2, "mu": 0.02}}
    double, chain = (
        dj.theory.local_margin(dj.Study.from_table(table), **walk, kind=Time.CONTINUOUS).dataset["critical"].item()
        for table in (alone, CHANNEL | {"actuator": [LAG, LIMIT, LAG]})
    )
    assert chain == pytest.approx(double, rel=1e-6)
    with pytest.raises(ConfigError, match=r"actuator.kind: the continuous-time analysis covers .* got 'delay \+ lag'"):
        dj.theory.local_margin(dj.Study.from_table(CHANNEL | {"actuator": [BUS, LAG]}), **walk, kind=Time.CONTINUOUS)


def test_a_chain_with_one_time_constant_has_it():
    assert time_constant_of(chained(LIMIT, SERVO)) == "actuator.servo.mu"
    with pytest.raises(ConfigError, match=r"actuator.kind: chattering needs dynamics with a time constant"):
        time_constant_of(chained(SERVO, LAG))


def test_proofs_and_theorem_tell_what_they_do_not_cover():
    study = dj.Study.load("certified_margin").override({"unmodelled": {"kind": "none"}})
    lag = {"kind": "lag", "mu": 0.01}
    alone, chain = (study.override(change) for change in ({"unmodelled": lag}, {"actuator": [lag]}))
    assert problem_of(chain) == problem_of(alone)
    uncertain = study.override({"actuator": [lag | {"mu": {"uniform": [0.005, 0.01]}}]})
    assert problem_of(uncertain).mu == (0.005, 0.01)
    with pytest.raises(NotCovered, match=r"the actuators form a chain, lag \+ lag"):
        problem_of(study.override({"actuator": [lag, lag]}))
    values = np.array([0.001, 0.01])
    assert reach(chain, "actuator.0.mu", values).value == reach(alone, "unmodelled.mu", values).value
    both = reach(study.override({"actuator": [lag, lag]}), "actuator.0.mu", values)
    assert both.value is None
    assert "other elements" in both.text
