"""The verifier's enclosures hold what they enclose: Table 1's gains over a region, the held plant over a box."""

import copy
import json
from math import comb

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flint import arb
from scipy.linalg import expm

import dssc_jax as dj
from dssc_jax.proofs.coverage import problem_of
from dssc_jax.proofs.prove import prove
from dssc_jax.proofs.search.gains import GAIN_NAMES, implicit_gains
from dssc_jax.proofs.search.held_plant import control_points
from dssc_jax.proofs.search.sampled_loop import functions_of
from dssc_jax.proofs.verifier.gain_enclosures import enclosed_gains
from dssc_jax.proofs.verifier.held_plant import held_generator, held_vertices
from dssc_jax.proofs.verifier.intervals import Intervals, exactly
from dssc_jax.proofs.verifier.verdict import ball_precision, verify_certificate
from tests.proofs.cases import LOOP

WIDE = LOOP.override({"unmodelled.mu": {"uniform": [0.005, 0.008]}})


@pytest.mark.parametrize(
    ("sigma", "e", "sigma_from"), [(0.3, 0.2, 0.0), (3.0, 0.01, 0.5), (1e-6, 2.0, 0.0), (1e-12, 1e-12, 0.0)]
)
def test_gains_of_table_1_lie_in_their_balls(sigma, e, sigma_from):
    """20,000 points of the region, by the package's own functions; the balls are hardly wider than what they span."""
    problem, rng = problem_of(LOOP), np.random.default_rng(1)
    balls = enclosed_gains(problem.to_dict(), sigma, e, sigma_from)
    s = rng.choice([-1.0, 1.0], 20_000) * (sigma_from + (sigma - sigma_from) * rng.beta(0.3, 0.3, 20_000))
    x = e * (2.0 * rng.beta(0.3, 0.3, 20_000) - 1.0)
    with jax.enable_x64(True):
        numbers = jnp.float64(problem.l0), jnp.float64(problem.sample_time), jnp.float64(0.0)
        gains = implicit_gains(functions_of(problem), jnp.asarray(s), jnp.asarray(x), *numbers)
    for name in GAIN_NAMES:
        values, (low, high) = np.asarray(gains[name]), (float(balls[name].lower()), float(balls[name].upper()))
        rounding = 1e-12 * np.abs(values).max()
        assert low - rounding <= values.min()
        assert values.max() <= high + rounding
        assert high - low <= 1.1 * np.ptp(values) + 1e-9 * abs(high)


def test_intervals_hold_the_exact_results():
    """Of numbers of all sizes, in ball arithmetic of 160 bits; an interval times itself holds its squares."""
    rng = np.random.default_rng(2)
    a, b = (rng.standard_normal(300) * 10.0 ** rng.integers(-20, 20, 300) for _ in range(2))
    x, y = Intervals(a, a), Intervals(np.abs(b), np.abs(b))
    results = {"+": x + y, "-": x - y, "*": x * y, "/": x / y}
    with ball_precision():
        for i, (left, right) in enumerate(zip(a.tolist(), np.abs(b).tolist(), strict=True)):
            p, q = arb(left), arb(right)
            for name, value in {"+": p + q, "-": p - q, "*": p * q, "/": p / q}.items():
                assert arb(float(results[name].low[i])) < value
                assert value < arb(float(results[name].high[i]))
    wide = Intervals(np.array([-2.0]), np.array([3.0]))
    assert (wide * wide).low[0] <= -6.0
    assert (wide * wide).high[0] >= 9.0
    assert np.isnan((exactly(1.0) / wide).low).all()


@pytest.mark.parametrize("degree", [1, 2, 5])
def test_the_held_plant_is_a_convex_combination_of_its_vertices(degree):
    """At any 1/mu of the box, with Bernstein's weights and within the vertices' own balls; both sides agree on them."""
    problem = problem_of(WIDE)
    content, box = problem.to_dict(), json.loads(json.dumps(problem.box))
    vertices, t = held_vertices(content, box, degree), problem.sample_time
    size = vertices[0].nrows()
    middles, radii = (
        np.array([[[float(of(balls[i, j])) for j in range(size)] for i in range(size)] for balls in vertices])
        for of in (arb.mid, arb.rad)
    )
    for held, vertex in zip(control_points(problem, problem.a_p[0], problem.box["rate"], degree), middles, strict=True):
        assert np.abs(np.column_stack([held.phi, held.gamma]) - vertex[:-1]).max() < 1e-12
    low, high = box["rate"]
    for share in np.linspace(0.0, 1.0, 11):
        f = held_generator(content, arb(problem.a_p[0]), arb(low + share * (high - low)))
        exact = expm(t * np.array([[float(f[i, j].mid()) for j in range(size)] for i in range(size)]))
        weights = [comb(degree, i) * share**i * (1.0 - share) ** (degree - i) for i in range(degree + 1)]
        assert np.all(np.abs(exact - np.tensordot(weights, middles, 1)) <= radii.max(axis=0) + 1e-14)


def test_a_wide_interval_of_mu_is_proved_in_one_box():
    """From 5 to 8 ms; a certificate of a lower degree, of a wider interval or of a degree that is none is refused."""
    outcome = prove(WIDE, boxes=1)
    assert outcome.complete, outcome.failures
    certificate = json.loads(json.dumps(outcome.certificate()))
    assert verify_certificate(certificate).proved
    for premise, degree, largest_mu in (("P6", 1, 0.008), ("P6", None, 0.03), ("P0", 0, 0.008), ("P0", 2.0, 0.008)):
        content = copy.deepcopy(certificate)
        content["problem"]["mu"] = [0.005, largest_mu]
        content["proofs"][0]["box"]["rate"] = [1.0 / largest_mu, 1.0 / 0.005]
        for stage in content["proofs"][0]["stages"]:
            if stage["method"] == "invariant set" and degree is not None:
                stage["degree"] = degree
        verdict = verify_certificate(content)
        assert not verdict.proved
        assert verdict.reason.startswith(f"{premise}: "), (premise, verdict.reason)
    for mu in (0.005, 0.0065, 0.008):
        study = LOOP.override({"unmodelled.mu": mu, "metrics": {"after": 0.0, "names": ["error_max"]}})
        assert dj.run(study).dataset["error_max"].values.max() <= outcome.largest_error
