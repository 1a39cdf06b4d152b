"""List scheduling: a valid order, in which chains that do not wait for each other alternate."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dssc_jax.lanes.passes.scheduling import schedule, users_of
from dssc_jax.lanes.traced_lanes import PACKINGS, Packing
from dssc_jax.lanes.tracing.translate import translate
from tests.lanes.against_plain import X, Y, both


def chains(x, y):
    """Many quotients in two chains, a branch and a loop that read them, and a recording."""
    a, b = x, y
    for n in range(40):
        a = 1.0 / (a * a + n + 1.0)
    for n in range(40):
        b = 1.0 / (b * b + n + 2.0)
    c = jax.lax.cond(a > b, lambda: jnp.exp(a), lambda: jnp.sqrt(b))
    last, several = jax.lax.scan(lambda s, k: (0.5 * s + c, s * b + k), a, jnp.arange(5.0))
    return last * a - b, several


@pytest.mark.parametrize("window", [0, 5, 1000])
def test_the_order_of_nodes_keeps_operands_first(window):
    scalar = jax.ShapeDtypeStruct((), np.float64)
    nodes = translate(chains, scalar, scalar)[0].body.nodes
    order = schedule(nodes, window)
    assert sorted(map(id, order)) == sorted(map(id, nodes))
    assert [id(node) for node in schedule(nodes, 0)] == [id(node) for node in nodes]
    place = {id(node): i for i, node in enumerate(order)}
    for i, several in enumerate(users_of(nodes)):
        assert all(place[id(nodes[i])] < place[id(nodes[user])] for user in several)
    for i, node in enumerate(order):
        assert nodes.index(node) - i <= window
    assert sum(map(len, users_of(nodes))) > len(nodes)


@pytest.mark.parametrize("window", [0, 40, 5000])
def test_strict_results_do_not_depend_on_the_order(window, monkeypatch):
    plain = both(chains, X, Y, strict=True)[0]
    packing = Packing(np.inf, 1, window)
    monkeypatch.setattr("dssc_jax.lanes.traced_lanes.PACKINGS", dict.fromkeys(PACKINGS, (packing,)))
    for one, other in zip(both(chains, X, Y, strict=True)[0], plain, strict=True):
        np.testing.assert_array_equal(one, other)


def test_chains_that_do_not_wait_for_each_other_alternate():
    scalar = jax.ShapeDtypeStruct((), np.float64)
    nodes = translate(chains, scalar, scalar)[0].body.nodes

    quotients = [id(node) for node in nodes if getattr(node, "operation", "") == "div"]
    first = set(quotients[:40])

    def turns(order):
        chains = [id(node) in first for node in order if id(node) in quotients]
        return sum(one != other for one, other in itertools.pairwise(chains))

    assert turns(nodes) == 1
    assert turns(schedule(nodes, 1000)) > 70
