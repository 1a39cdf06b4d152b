"""Adversarial simulations of proved loops, with a plant of their own: does any leave what is proved?

The plant, its lag and the disturbance are integrated exactly by a matrix exponential that is built here; the controller
is the package's own, with its clip. Plants are at the corners of the laws or within. Disturbances have the steepest
slope at all times: triangles of any period, and the sign of the loop's impulse response turned in time, which is the
worst input of the linear loop.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.linalg import expm

import dssc_jax as dj
from dssc_jax.core.signals import Measurement, ReferencePoint
from dssc_jax.proofs.coverage import problem_of
from dssc_jax.proofs.problem import ProofProblem

SETTLED = 0.6
"""Share of a simulation after which the settled bound is held against it."""


WORST_INPUTS = 0.05
"""Share of simulations with the linear loop's worst input."""


class Flown(NamedTuple):
    """Largest |e| [m] of each simulation, from the start on and once settled, and its least sliding margin [m/s]."""

    largest: np.ndarray
    settled: np.ndarray
    sliding: np.ndarray


def adversarial(study: dj.Study, count: int, seconds: float, seed: int) -> Flown:
    """Simulate a study without uncertain lag from its own start.

    Args:
        study: A study that :func:`dssc_jax.proofs.problem.problem_of` covers, with a lag of order 2.
        count: Number of simulations.
        seconds: Length of each.
        seed: Of plants and disturbances.
    """
    problem, rng = problem_of(study), np.random.default_rng(seed)
    t, steps = problem.sample_time, round(seconds / problem.sample_time)
    corner = rng.random(count) < 0.5
    k_p, a_p = (
        np.where(corner, rng.choice(pair, count), rng.uniform(*pair, count)) for pair in (problem.k_p, problem.a_p)
    )
    mu = rng.choice(problem.mu, count)
    held = np.stack([plant_over_sample(*each, t) for each in zip(k_p, a_p, mu, strict=True)])
    slopes = disturbance_slopes(rng, held, study, problem.slope, problem.level, count, steps)
    first = rng.choice([0.0, -1.0, 1.0], count) * (problem.level - t * problem.slope)
    controller, gains = study.loop.controller[0], study.template.controller[0]
    with jax.enable_x64(True):
        flown = fly(controller, gains, jnp.asarray(held), jnp.asarray(slopes), jnp.asarray(first), problem)
    return Flown(*map(np.asarray, flown))


def plant_over_sample(k_p: float, a_p: float, mu: float, t: float) -> np.ndarray:
    """One sample of (e, e', x_1, x_2) with u and d' held: rows of the state, columns of (state, u, d, d')."""
    f = np.zeros((7, 7))
    f[0, 1], f[1, 1], f[1, 3], f[1, 5] = 1.0, -a_p, k_p, k_p
    f[2, 2], f[2, 4], f[3, 2], f[3, 3] = -1.0 / mu, 1.0 / mu, 1.0 / mu, -1.0 / mu
    f[5, 6] = 1.0
    return expm(f * t)[:4]


def disturbance_slopes(
    rng: np.random.Generator, held: np.ndarray, study: dj.Study, slope: float, level: float, count: int, steps: int
) -> np.ndarray:
    """Signs of d' at each sample, (steps, count): triangles, and impulse responses turned in time."""
    t = study.loop.sample_time
    period = np.exp(rng.uniform(np.log(8.0 * t), np.log(steps * t), count))
    phase = rng.random(count)
    time = t * np.arange(steps)[:, None]
    signs = np.where(((time / period + phase) % 1.0) < 0.5, 1.0, -1.0)
    for i in np.flatnonzero(rng.random(count) < WORST_INPUTS):
        response = impulse_response(held[i], study, steps)
        signs[:, i] = np.where(response[::-1] < 0.0, -1.0, 1.0) * rng.choice([-1.0, 1.0])
    return slope * signs


def impulse_response(held: np.ndarray, study: dj.Study, steps: int) -> np.ndarray:
    """e after a jump of d, with the loop linearised at sigma = e = 0 and the implicit form's gains."""
    gains, t = study.template.controller[0], study.loop.sample_time
    with jax.enable_x64(True):
        at = gains.functions.at(jnp.float64(1e-12), jnp.float64(0.0), gains.l0)
    k_o, tau_av, tau_m = (float(each) for each in at)
    k_p, k_i, l0 = 1.0 / (k_o * tau_av), 1.0 / (k_o * tau_av * tau_m), float(gains.l0)
    a = np.zeros((7, 7))  # e, e', x_1, x_2, v, sigma before, d
    sigma = np.array([l0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    v = np.eye(7)[4] + (k_p + t * k_i) * sigma - k_p * np.eye(7)[5]
    a[:4, :4], a[:4, 6] = held[:, :4], held[:, 5]
    a[:4] -= np.outer(held[:, 4], v)
    a[4], a[5], a[6, 6] = v, sigma, 1.0
    z, values = np.eye(7)[6], np.empty(steps)
    for k in range(steps):
        values[k] = z[0]
        z = a @ z
    return values


def fly(
    controller: Any, gains: Any, held: jax.Array, slopes: jax.Array, first: jax.Array, problem: ProofProblem
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """All simulations at once: largest |e|, that after SETTLED, and the least sliding margin."""
    t, steps, count = problem.sample_time, *slopes.shape
    low, high = (np.array([pair[i] for pair in problem.initial]) for i in (0, 1))
    still = ReferencePoint(0.0, 0.0, 0.0)
    state = jnp.zeros((4, count)).at[:2].set(jnp.asarray(0.5 * (low + high))[:2, None])
    own = jax.vmap(lambda y, v: controller.init(gains, Measurement(y, v), still))(state[0], state[1])
    own = jax.tree.map(lambda leaf: jnp.broadcast_to(jnp.asarray(leaf, float), (count,)), own)

    def lane(own: Any, y: jax.Array, v: jax.Array) -> Any:
        own, command, info = controller.step(gains, own, Measurement(y, v), still, t)
        return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), own), command.total, info.sliding_margin

    def sample(carry: Any, inputs: Any) -> Any:
        state, own, d, largest, settled, sliding = carry
        slope, late = inputs
        own, u, margin = jax.vmap(lane)(own, state[0], state[1])
        kept = jnp.clip(slope, (-problem.level - d) / t, (problem.level - d) / t)
        full = jnp.concatenate([state, u[None], d[None], kept[None]])
        state = jnp.einsum("nij,jn->in", held, full)
        size = jnp.abs(state[0])
        after = jnp.where(late, jnp.maximum(settled, size), settled)
        return (state, own, d + t * kept, jnp.maximum(largest, size), after, jnp.minimum(sliding, margin)), None

    late = np.arange(steps) >= SETTLED * steps
    start = (state, own, first, jnp.abs(state[0]), jnp.zeros(count), jnp.full(count, jnp.inf))
    (_, _, _, largest, settled, sliding), _ = jax.jit(lambda s: jax.lax.scan(sample, s, (slopes, late)))(start)
    return largest, settled, sliding
