"""Transfer functions in series with the input: against SciPy's own discretisation, the lags, and each other."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.plain import plain_options
from dssc_jax.models.actuators import UNMODELLED
from dssc_jax.study.components import parse_component
from tests.loops import LAGGED
from tests.tolerances import ROUNDING

COMMANDS = np.array([1.0, 1.0, -0.5, 2.0, 0.0, 0.0, 0.3, -1.0])
DT = 0.01


def of_poles(*poles, numerator=(1.0,)):
    """Numerator and denominator in rising powers, with G(0) = 1."""
    rising = np.real(np.poly(poles))[::-1]
    return list(numerator), [1.0, *(rising[1:] / rising[0]).tolist()]


SHAPES = {
    "first order": of_poles(-1.0),
    "lead-lag": of_poles(-1.0, numerator=(1.0, 0.3)),
    "resonance": ([1.0], [1.0, 0.02, 1.0]),
    "complex, non-minimum phase": of_poles(-1 + 2j, -1 - 2j, numerator=(1.0, -0.7)),
    "complex, with feedthrough": of_poles(-0.3 + 1j, -0.3 - 1j, numerator=(1.0, 0.1, 0.5)),
    "all-pass": ([1.0, -0.5, 1 / 12], [1.0, 0.5, 1 / 12]),
    "triple": of_poles(-1.0, -1.0, -1.0),
    "nearly triple": of_poles(-1.0, -1.0001, -0.9999),
    "far apart": of_poles(-0.01, -1.0, -100.0, numerator=(1.0, 0.3)),
    "Butterworth": of_poles(*np.roots(signal.butter(6, 1.0, analog=True)[1])),
    "sextuple": of_poles(*[-1.0] * 6),
    "not normalised": ([3.0], [3.0, 6e-3, 3e-6]),
}


def parsed(**table):
    part = parse_component({"kind": "transfer_function", **table}, UNMODELLED, "unmodelled")
    return part.model, part.params


def responses(model, params, commands=COMMANDS, dt=DT):
    """Output at the end of every sample, its command held."""
    state, found = model.init(params), []
    advance = jax.jit(lambda state, u: model.step(params, state, u, dt))
    for u in commands:
        state = advance(state, u)
        found.append(float(model.output(params, state, u)))
    return np.array(found)


def expected(numerator, denominator, mu, commands=COMMANDS, dt=DT):
    """The same by ``scipy.signal.cont2discrete``, in units of mu: outputs at the ends of the samples."""
    descending = numerator[::-1], denominator[::-1]
    a, b, c, d = signal.tf2ss(*descending)
    ad, bd, *_ = signal.cont2discrete((a, b, c, d), dt / mu, method="zoh")
    state, found = np.zeros((len(a), 1)), []
    for u in commands:
        state = ad @ state + bd * u
        found.append((c @ state + d * u).item())
    return np.array(found)


@pytest.mark.parametrize("mu", [1e-4, 1e-2, 0.15, 10.0])
@pytest.mark.parametrize("shape", SHAPES)
def test_it_is_the_zero_order_hold_of_scipy(shape, mu):
    numerator, denominator = SHAPES[shape]
    found = responses(*parsed(mu=mu, numerator=numerator, denominator=denominator))
    np.testing.assert_allclose(found, expected(numerator, denominator, mu), rtol=1e-10, atol=2e-12)


@pytest.mark.parametrize("mu", [1e-200, 1e-12, 1e12])
def test_no_mu_is_too_small_or_too_large(mu):
    """A small one passes the command on, a large one nothing of it."""
    numerator, denominator = SHAPES["far apart"]
    found = responses(*parsed(mu=mu, numerator=numerator, denominator=denominator))
    np.testing.assert_allclose(found, COMMANDS if mu < 1.0 else 0.0, atol=1e-12)


@pytest.mark.parametrize("dt", [1e-4, 0.03, 2.0])
@pytest.mark.parametrize("order", [1, 2])
def test_it_is_the_lag(order, dt):
    lag = parse_component({"kind": "lag", "order": order, "mu": 0.03}, UNMODELLED, "unmodelled")
    shape = {"numerator": [1.0], "denominator": [1.0, 1.0] if order == 1 else [1.0, 2.0, 1.0]}
    found, known = responses(*parsed(mu=0.03, **shape), dt=dt), responses(lag.model, lag.params, dt=dt)
    np.testing.assert_allclose(found, known, rtol=ROUNDING, atol=1e-15)


def test_many_short_steps_are_one_long_one():
    """Within the digits that a pole near the imaginary axis leaves."""
    for numerator, denominator in SHAPES.values():
        model, params = parsed(mu=0.02, numerator=numerator, denominator=denominator)
        short = responses(model, params, np.full(64, 0.7), dt=DT / 64)
        long = responses(model, params, [0.7])
        assert short[-1] == pytest.approx(long[-1], abs=1e-12)


def test_the_loop_is_the_one_with_the_lag():
    """A whole run; and with direct feedthrough, whatever the substeps: it is exact."""
    lagged = dj.Study.from_table(LAGGED | {"name": "lag", "draws": 8})
    shape = {"numerator": [1], "denominator": [1, 2, 1]}
    equal = lagged.override({"unmodelled": {"kind": "transfer_function", "mu": 0.02, **shape}})
    known, found = (dj.run(study).dataset["error_rms"].values for study in (lagged, equal))
    np.testing.assert_allclose(found, known, rtol=1e-9)
    filtered = equal.override({"unmodelled.numerator": [1, 0.5, 0.25]})
    runs = [dj.run(filtered.override({"loop.substeps": n})).dataset["error_rms"].values for n in (1, 16)]
    np.testing.assert_allclose(runs[0], runs[1], rtol=1e-11)


@pytest.mark.parametrize("shape", ["resonance", "complex, with feedthrough", "sextuple"])
def test_derivative_with_respect_to_mu(shape):
    """Forward and reverse, against central differences, on both sides of a digit's change."""
    numerator, denominator = SHAPES[shape]
    model, params = parsed(mu=0.02, numerator=numerator, denominator=denominator)

    def after(mu):
        def sample(state, u):
            return model.step(params._replace(mu=mu), state, u, DT), None

        start = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), model.init(params))
        return model.output(params, jax.lax.scan(sample, start, jnp.array([1.0, -0.4]))[0], 0.0)

    value_and_forward, reverse = (
        jax.jit(function, compiler_options=plain_options())
        for function in (lambda mu: jax.jvp(after, (mu,), (1.0,)), jax.grad(after))
    )
    for mu in (0.005, 0.02, 0.3):
        width = 1e-5 * mu
        above, below = (value_and_forward(mu + sign * width)[0] for sign in (1, -1))
        slope = float((above - below) / (2.0 * width))
        for derivative in (value_and_forward(mu)[1], reverse(mu)):
            assert float(derivative) == pytest.approx(slope, rel=1e-6, abs=1e-7 / mu)


def test_single_precision_is_kept():
    numerator, denominator = SHAPES["Butterworth"]
    model, params = parsed(mu=0.02, numerator=numerator, denominator=denominator)
    with jax.enable_x64(False):
        state = model.step(params, tuple(map(jnp.float32, model.init(params))), jnp.float32(1.0), jnp.float32(DT))
        state = model.step(params._replace(mu=jnp.float32(0.02)), state, jnp.float32(1.0), DT)
        assert {leaf.dtype for leaf in state} == {jnp.dtype(jnp.float32)}
        found = float(model.output(params, state, jnp.float32(1.0)))
    assert found == pytest.approx(expected(numerator, denominator, 0.02)[1], abs=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"denominator": [1]}, r"unmodelled.denominator: must have 2 to 7 coefficients, got 1"),
        ({"denominator": [1] * 8}, r"unmodelled.denominator: must have 2 to 7 coefficients, got 8"),
        ({"numerator": []}, r"unmodelled.numerator: must have 1 to 3 coefficients, .*proper\), got 0"),
        ({"numerator": [1, 0, 0, 1]}, r"unmodelled.numerator: must have 1 to 3 .*proper\), got 4"),
        ({"numerator": [2]}, r"unmodelled.numerator: must begin with .* G\(0\) = 1, got 2 and 1"),
        ({"numerator": [0], "denominator": [0, 1]}, r"unmodelled.numerator: .* not be 0, .* got 0 and 0"),
        ({"denominator": [1, -1, 1]}, r"unmodelled.denominator: must be Hurwitz.* got \[1.0, -1.0, 1.0\]"),
        ({"denominator": [1, 0, 1]}, "unmodelled.denominator: must be Hurwitz"),
        ({"denominator": [1, 1, 1, 1]}, "unmodelled.denominator: must be Hurwitz"),
        ({"denominator": [1, 2, 0]}, "unmodelled.denominator: must be Hurwitz"),
        ({"numerator": [1e-300], "denominator": [1e-300, 1, 1e300]}, "unmodelled.denominator: must be Hurwitz"),
        (
            {"numerator": [1e-300, 1e300], "denominator": [1e-300, 1e-300]},
            "unmodelled.numerator: must be in proportion",
        ),
        ({"denominator": [1, 1e20, 1]}, "no pole slower than 1e-06 of their geometric mean"),
        ({"denominator": [1, {"uniform": [1, 2]}, 1]}, "unmodelled.denominator: must be a plain number here"),
        ({"denominator": 1.0}, "unmodelled.denominator: must be a list of numbers"),
        ({"mu": 0.0}, "unmodelled.mu: time constant .* must be > 0, got 0"),
        ({"denominatr": [1]}, r"unmodelled.denominatr: unknown name; did you mean 'denominator'\?"),
    ],
)
def test_bad_input_is_told_in_one_line(changes, message):
    with pytest.raises(ConfigError, match=message) as caught:
        parsed(**({"mu": 0.1, "numerator": [1], "denominator": [1, 2, 1]} | changes))
    assert "\n" not in str(caught.value)


def test_a_coefficient_is_not_swept():
    table = {"kind": "transfer_function", "mu": 0.1, "numerator": [1], "denominator": [1, 2, 1]}
    with pytest.raises(ConfigError, match=r"sweep.unmodelled.denominator.1: is fixed before tracing"):
        dj.Study.from_table(
            LAGGED | {"name": "swept", "unmodelled": table, "sweep": {"unmodelled.denominator.1": [1.0, 2.0]}}
        )
