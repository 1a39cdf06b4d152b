"""Commands in another unit: refused with the factor, where it is certain and the estimates are no vehicle's."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.possible_values import is_beyond_by_ratio
from dssc_jax.flight_logs.fit.refusals import Unexplained
from dssc_jax.flight_logs.hints.command_hints import command_unit
from dssc_jax.flight_logs.reading.reader import Column
from dssc_jax.flight_logs.replay import replay_log
from dssc_jax.study import Law
from tests.flight_logs.fit.test_fit import DT, linear, log_of, output

TIME = DT * np.arange(400)
GRAVITY = 9.80665
UNITS = {"output": "m", "command": "N"}


def command():
    return np.sin(3.0 * TIME) + 0.3 * np.sin(11.0 * TIME)


@pytest.mark.parametrize(
    ("factor", "unit", "words"),
    [
        (1.0 / GRAVITY, "N", "times 0.102 (kilograms-force in place of newtons)"),
        (1000.0 / GRAVITY, "N", "times 102 (grams-force in place of newtons)"),
        (GRAVITY, "N", "times 9.807"),
        (1.0 / GRAVITY, "m/s^2", "times 0.102 (multiples of g in place of m/s^2)"),
        (GRAVITY, "1", "times 9.807 (newtons in place of kilograms-force, or m/s^2 in place of g)"),
        (31.4, "1", "is 31.4 times what the analysed controller gives"),
        (0.031, "N", "a scale of 32.26 in the table of columns mends it"),
        (-2.0, "N", "is -2 times what the analysed controller gives"),
        (1.0, "N", ""),
        (3.0, "N", ""),  # other gains
        (3.281, "N", ""),  # feet are no force
        (0.4, "1", ""),
    ],
)
def test_the_unit_of_a_command(factor, unit, words):
    """Beside a noise of 3 % where the unit is known; a large multiple without a name is one at all times."""
    noise = 0.03 * np.random.default_rng(0).normal(size=400) if "place of" in words else 0.0
    text = command_unit(factor * (command() + noise), command(), unit)
    assert words in text
    assert bool(words) == bool(text)


def test_a_multiple_with_an_offset():
    """The thrust as a share of 40 N, with that of the hover: u = (u_total + 19.6)/40."""
    text = command_unit((command() + 19.6) / 40.0, command(), "N")
    assert text.startswith("is 0.025 times what the analysed controller gives")
    assert ", plus 0.49: " in text
    assert "a scale of 40 with an offset of -19.6 in the table of columns" in text
    assert command_unit(1.3 * command() + 19.6, command(), "N") == ""  # other gains, and another start of the integral


@pytest.fixture(scope="module")
def flight():
    """A command of 1 N or so, and the output of known numbers with 1 cm of noise."""
    random = np.random.default_rng(8)
    u = np.repeat(random.normal(size=40), 10)
    return u, output(1.1, 0.8, u) + 0.01 * random.normal(size=400)


@pytest.mark.parametrize(
    ("factor", "words"),
    [(GRAVITY, "times 9.807"), (1.0 / GRAVITY, "times 0.102"), (1000.0 / GRAVITY, "times 10"), (1000.0, "times 1000")],
)
def test_estimates_of_another_unit_are_refused(flight, factor, words):
    """The log lacks what a replay needs, so that the laws alone tell."""
    u, y = flight
    with pytest.raises(Unexplained, match=rf"best value of plant\.k_p is .* {words}"):
        fit_log(linear(units=UNITS), log_of(y, factor * u))


def test_honest_estimates_outside_their_law_are_accepted(flight):
    """A gain of 1.1 where the law ends at 0.5, or begins at 2: no unit is at fault, and a warning tells."""
    u, y = flight
    for ends in ([0.3, 0.5], [2.0, 3.0]):
        plant = linear().table["plant"] | {"k_p": {"uniform": ends}}
        fitted = fit_log(linear(units=UNITS, plant=plant), log_of(y, u), ["plant.k_p", "plant.a_p"])
        assert fitted.estimates[0] == pytest.approx(1.1, rel=0.1)
        assert any("lies outside its law" in warning.text for warning in fitted.warnings)


def test_values_far_beside_a_law():
    law = Law("uniform", (0.5, 1.5))
    assert [is_beyond_by_ratio(law, value) for value in (0.1, 0.4, 1.0, 4.0, 5.0, -0.1)] == [
        True,
        False,
        False,
        False,
        True,
        False,
    ]


def test_a_replayed_command_in_kilograms_force_is_refused():
    study = linear(draws=1, units=UNITS)
    run = dj.simulate(study, 0)
    columns = {name: Column(run["t"].values, run[name].values) for name in ("y", "y_dot", "y_ref", "u_total")}
    columns["u_total"] = columns["u_total"]._replace(value=columns["u_total"].value / GRAVITY)
    log = log_of(columns["y"].value)._replace(columns=columns)
    with pytest.raises(ConfigError, match=r"u_total is the analysed controller.s times 0\.102 .kilograms-force"):
        fit_log(study, log, replay=replay_log(study, log))
