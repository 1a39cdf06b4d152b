"""Dead zone, backlash, lost commands and transfer functions of s: against closed forms, and their refusals."""

import jax
import numpy as np
import pytest
from scipy.signal import StateSpace, lti

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.models.actuators import UNMODELLED
from dssc_jax.models.actuators.rate_limit import RATE_LIMIT, RateLimitParams
from dssc_jax.models.actuators.rational import RATIONAL
from dssc_jax.study.components import parse_component
from tests.conftest import UNCERTAIN

SAMPLES = 4000
ANGLES = 2.0 * np.pi * np.arange(2 * SAMPLES) / SAMPLES  # two periods


def parsed(**table):
    return parse_component(table, UNMODELLED, "unmodelled")


def response(part, commands):
    """The output at each sample of a sequence of commands."""

    def sampled(state, command):
        state = part.model.sample(part.params, state, command, jax.random.key(0), 0.1)
        return state, part.model.output(part.params, state, command)

    begin = jax.tree.map(jax.numpy.asarray, part.model.init(part.params))
    with jax.enable_x64(True):
        begin = jax.tree.map(lambda x: x.astype(float), begin)
        return np.asarray(jax.lax.scan(sampled, begin, jax.numpy.asarray(commands))[1])


def first_harmonic(part, amplitude):
    """The describing function at an amplitude, from the second period of the response to a sine."""
    found = response(part, amplitude * np.sin(ANGLES))[SAMPLES:]
    return 2.0j * np.mean(found * np.exp(-1j * ANGLES[SAMPLES:])) / amplitude


@pytest.mark.parametrize("amplitude", [0.25, 0.6, 3.0])
def test_a_dead_zone_has_its_describing_function(amplitude):
    """N = 1 - 2/pi (asin(r) + r sqrt(1 - r^2)), r = half-width/amplitude."""
    r = 0.2 / amplitude
    expected = 1.0 - 2.0 / np.pi * (np.arcsin(r) + r * np.sqrt(1.0 - r * r))
    assert first_harmonic(parsed(kind="dead_zone", half_width=0.2), amplitude) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("amplitude", [0.25, 0.6, 3.0])
def test_backlash_has_its_describing_function(amplitude):
    """Of the play: b = 1 - 2 r, N = (pi/2 + asin(b) + b sqrt(1 - b^2))/pi - j (1 - b^2)/pi."""
    b = 1.0 - 2.0 * 0.2 / amplitude
    expected = (np.pi / 2 + np.arcsin(b) + b * np.sqrt(1.0 - b * b) - 1j * (1.0 - b * b)) / np.pi
    assert first_harmonic(parsed(kind="backlash", half_width=0.2), amplitude) == pytest.approx(expected, abs=2e-3)


def test_play_does_not_depend_on_rate_and_rests_within_the_gap():
    part = parsed(kind="backlash", half_width=0.2)
    commands = np.array([0.1, -0.1, 0.5, 0.4, 0.1, -0.2, -0.1, 0.3])
    slow = np.concatenate([np.linspace(a, b, 51)[1:] for a, b in zip(np.append(0.0, commands), commands, strict=False)])
    np.testing.assert_allclose(response(part, slow)[49::50], response(part, commands), atol=1e-12)
    np.testing.assert_allclose(response(part, commands), [0, 0, 0.3, 0.3, 0.3, 0.0, 0.0, 0.1], atol=1e-12)


@pytest.mark.parametrize("kind", ["dead_zone", "backlash"])
def test_no_width_has_no_effect_and_gradients_are_finite(kind):
    part = parsed(kind=kind, half_width=0.0)
    commands = np.array([0.3, -1.0, 0.0, 2.0])
    np.testing.assert_allclose(response(part, commands), commands, atol=1e-15)

    def output(width, command):
        params = part.model.params(width)
        state = part.model.sample(params, part.model.init(params), command, jax.random.key(0), 0.1)
        return part.model.output(params, state, command)

    for at in ((0.2, 0.0), (0.2, 0.2), (0.0, 0.0), (0.2, 1.0)):
        assert np.all(np.isfinite(jax.grad(output, argnums=(0, 1))(*at)))


@pytest.mark.parametrize("slope", [3.0, 1.0, -1.0, -6.0])
@pytest.mark.parametrize("start", [-0.4, 0.0, 0.05, 0.4])
def test_a_rate_limit_follows_a_straight_command_exactly(start, slope):
    """Towards it, then with it or behind it; against many short steps."""
    rate, dt, parts, z = 2.0, 0.1, 20_000, 0.0
    (found,) = RATE_LIMIT.follow(RateLimitParams(rate), (z,), start, start + slope * dt, dt)
    for i in range(parts):
        u = start + slope * dt * (i + 1) / parts
        z += np.clip(u - z, -rate * dt / parts, rate * dt / parts)
    assert float(found) == pytest.approx(z, abs=1e-4)


def losing(probability, **changes):
    lost = {"unmodelled": {"kind": "lost_command", "probability": probability}, "sweep": {}, "requirement": []}
    return dj.Study.from_table(UNCERTAIN).override(lost | {"disturbance": {"kind": "none"}, "draws": 3} | changes)


def test_commands_are_lost_with_the_stated_probability():
    part = parsed(kind="lost_command", probability=0.3)

    def sampled(state, pair):
        key, command = pair
        state = part.model.sample(part.params, state, command, key, 0.1)
        return state, state[0]

    keys = jax.random.split(jax.random.key(1), 20_000)
    commands = jax.numpy.arange(1.0, 20_001.0)
    arrived = np.asarray(jax.lax.scan(sampled, (jax.numpy.asarray(0.0),), (keys, commands))[1])
    lost = arrived != np.asarray(commands)
    assert lost.mean() == pytest.approx(0.3, abs=0.015)
    assert np.corrcoef(lost[1:], lost[:-1])[0, 1] == pytest.approx(0.0, abs=0.03)
    assert np.all(np.diff(arrived) >= 0.0)


def test_losses_belong_to_the_draw():
    """Other draws lose others; a draw replays its own; without losses nothing changes."""
    first, again, other = (dj.simulate(losing(0.4), draw=draw)["y"].values for draw in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 1e-6
    kept, none = (dj.simulate(losing(0.0, **change))["y"].values for change in ({}, {"unmodelled": {"kind": "none"}}))
    np.testing.assert_allclose(kept, none, rtol=1e-12, atol=1e-14)


def stepped(part, dt, count):
    with jax.enable_x64(True):
        state, found = part.model.init(part.params), []
        for _ in range(count):
            state = part.model.step(part.params, state, 1.0, dt)
            found.append(float(part.model.output(part.params, state, 1.0)))
    return np.array(found)


RATIONALS = [
    ([2.0, 3.0], [0.01, 1.0]),
    ([1.0], [1e-4, 0.004, 1.0]),
    ([-0.02, 1.0], [0.02, 1.0]),
    ([1.0, 4.0], [1.0, 0.0]),
    ([5.0], [1e-6, 2e-3, 1.0, 0.0]),
]


@pytest.mark.parametrize(("numerator", "denominator"), RATIONALS)
def test_a_transfer_function_of_s_is_that_of_scipy(numerator, denominator):
    part = parsed(kind="rational", numerator=numerator, denominator=denominator)
    times = 0.01 * np.arange(1, 41)
    _, expected = lti(numerator, denominator).step(T=np.append(0.0, times))
    np.testing.assert_allclose(stepped(part, 0.01, 40), expected[1:], rtol=1e-9, atol=1e-12)
    found = RATIONAL.linear(part.params)
    matrices = StateSpace(np.array(found.a), np.array(found.b)[:, None], np.array(found.c)[None, :], found.d)
    s = 2.0 + 3.0j
    response = matrices.C @ np.linalg.solve(s * np.eye(len(found.a)) - matrices.A, matrices.B) + matrices.D
    assert complex(response[0, 0]) == pytest.approx(np.polyval(numerator, s) / np.polyval(denominator, s), rel=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"numerator": [1.0, 0.0, 0.0]}, r"numerator: must have 1 to 2 coefficients.*\(G must be proper\), got 3"),
        ({"denominator": [{"uniform": [-0.1, 0.1]}, 1.0]}, r"denominator.0: must not be or become 0.*\[-0.1, 0.1\]"),
        ({"denominator": [1.0] * 8}, "denominator: must have 1 to 7 coefficients, got 8"),
    ],
)
def test_improper_transfer_functions_are_refused(changes, message):
    with pytest.raises(ConfigError, match=message):
        parsed(**({"kind": "rational", "numerator": [1.0], "denominator": [0.1, 1.0]} | changes))


def test_coefficients_may_be_laws_and_expressions():
    table = UNCERTAIN | {
        "parameters": {"J": {"uniform": [0.01, 0.02]}},
        "unmodelled": {
            "kind": "rational",
            "numerator": [{"uniform": [0.9, 1.1]}],
            "denominator": ["=J", "=2*sqrt(J)", 1.0],
        },
        "sweep": {},
        "draws": 4,
    }
    result = dj.run(dj.Study.from_table(table), check=False)
    assert {"unmodelled.numerator.0", "parameters.J"} <= set(result.dataset)
    assert np.all(np.isfinite(result.dataset["error_max"].values))
