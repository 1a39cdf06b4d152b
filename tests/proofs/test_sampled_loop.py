"""The sampled loop of both constructions against the simulated one."""

import numpy as np
import pytest
from flint import arb

import dssc_jax as dj
from dssc_jax.proofs.coverage import problem_of
from dssc_jax.proofs.search.held_plant import sensor_weights, state_layout
from dssc_jax.proofs.search.sampled_loop import LoopGains, LoopPoint, step_of
from dssc_jax.proofs.verifier.enclosed_loop import sample_matrix
from dssc_jax.proofs.verifier.held_plant import held_sample
from tests.proofs.cases import CONSTANT, DIRECT, HIGHER, LOOP, NOMINAL, SINE, TRANSFER


def exact(point, problem):
    """A at a point by the verifier's own construction."""
    held = held_sample(problem, arb(point.a_p), arb(point.rate))
    matrix = sample_matrix(problem, held, arb(point.k_p), tuple(map(arb, point.gains)), is_integrated=False)
    return np.array([[float(matrix[i, j].mid()) for j in range(matrix.ncols())] for i in range(matrix.nrows())])


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"unmodelled": {"kind": "none"}},
        {"unmodelled": {"kind": "lag", "order": 1, "mu": 0.05}},
        {"unmodelled": TRANSFER},
        {"unmodelled": DIRECT, **NOMINAL},
        {"unmodelled": {"kind": "delay", "samples": 0.4, "memory": 4.0}},
        {"unmodelled": {"kind": "delay", "samples": 2.0, "memory": 4.0}, **HIGHER},
        {"unmodelled": {"kind": "delay", "samples": 2.7, "memory": 4.0}, "sensor": {"kind": "lag", "mu": 0.02}},
        {"sensor": {"kind": "lag", "mu": 0.004}, **NOMINAL},
        {**HIGHER, **NOMINAL},
        {**NOMINAL, "controller.nominal.predictor_term": False, "unmodelled": {"kind": "none"}, **HIGHER},
        {"reference": SINE},
        {"reference": SINE, **NOMINAL, "unmodelled": DIRECT},
        {"reference": SINE, **NOMINAL, "unmodelled": {"kind": "delay", "samples": 1.3, "memory": 4.0}},
    ],
    ids=lambda changes: " ".join(changes),
)
def test_one_sample_is_that_of_the_simulated_loop(changes):
    """Both constructions of A carry the recorded signals from sample to sample, with a constant disturbance."""
    study = LOOP.override(
        {
            "controller.functions": CONSTANT,
            "disturbance": {"kind": "constant", "value": 0.07},
            "loop.duration": 2.0,
            "loop.sample_time": 0.01,
            "loop.substeps": 16,
            **changes,
        }
    )
    run, problem = dj.simulate(study), problem_of(study)
    zeta, memory, n = state_layout(problem)
    gain, tau_m = 1.0 / (5.0 * 0.05), 0.5
    a_n, k_n, term = problem.nominal or (0.0, np.inf, False)
    rate = 1.0 / problem.mu[0] if problem.denominator else 0.0
    point = LoopPoint(1.0, 0.3, rate, LoopGains(gain, gain / tau_m, term / (k_n * tau_m)))
    step = step_of(problem, point, problem.box)
    a = step.a
    np.testing.assert_allclose(exact(point, problem.to_dict()), a, rtol=1e-12, atol=1e-14)

    t = 0.01 * np.arange(201)
    swing = SINE["amplitude"] if any(problem.reference) else 0.0
    y_dot, y_ddot = swing * np.cos(t), -swing * np.sin(t)
    d_r, f = 0.07 - y_ddot - 0.3 * y_dot, (y_ddot + a_n * y_dot) / k_n  # with k_p = 1
    z = np.zeros(n)
    z[0], z[1] = run["e"].values[0], run["y_dot"].values[0] - y_dot[0]
    assert z[:2] == pytest.approx([pair[0] for pair in problem.initial[:2]], abs=1e-12)
    z[zeta], z[n - 2] = d_r[0] * step.jump[zeta], -d_r[0] - f[0]
    z[memory] = sensor_weights(problem)[0] * z[: memory.stop - memory.start]
    z[n - 1] = z[1] + problem.l0 * z[0]
    inside, left = step.b[:, 2:], np.full(n, 3e-7)  # d_r(t) - d_r(t_k) acts between the samples
    for k in range(150):
        assert abs(z[0] - run["e"].values[k]) <= left[0]
        assert abs(z[1] - run["y_dot"].values[k] + y_dot[k]) <= left[1]
        z, left, inside = a @ z, left + np.abs(inside).sum(axis=1), a @ inside
        assert abs(z[n - 2] + d_r[k] + f[k] - run["u_av"].values[k]) <= left[n - 2]
        z += step.jump * (d_r[k + 1] - d_r[k])
        z[n - 2] -= d_r[k + 1] + f[k + 1] - d_r[k] - f[k]
    assert left[0] < 2e-4
