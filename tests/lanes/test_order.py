"""List scheduling: a valid order, in which chains that do not wait for each other alternate."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dssc_jax.lanes.passes.liveness import reachable
from dssc_jax.lanes.passes.negated_states import loops_of
from dssc_jax.lanes.passes.observation import observing_nodes, placed_early
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


def oscillator(x, y):
    """An oscillator whose peak is counted as long as no speed was above 3; the count and the peak move nothing."""

    def turn(k, state):
        place, speed, peak, fast, count = state
        next_speed = speed - 0.1 * jnp.sin(place)
        next_fast = fast | (next_speed > 3.0)
        seen = jnp.where(next_fast, 0.0, jnp.abs(place))
        return place + 0.1 * next_speed, next_speed, jnp.maximum(peak, seen), next_fast, count + jnp.where(fast, 0, 1)

    return jax.lax.fori_loop(0, 90, turn, (x, y, jnp.zeros(()), jnp.asarray(False), jnp.asarray(0)))


def test_what_only_observes_a_loop_comes_as_soon_as_its_operands_are_known():
    scalar = jax.ShapeDtypeStruct((), np.float64)
    program, _ = translate(oscillator, scalar, scalar)
    (loop,), needed = loops_of(program.body), reachable(program)
    nodes = [node for node in loop.body.nodes if id(node) in needed]
    early = observing_nodes(loop)
    observers = [node for node in nodes if id(node) in early]
    assert {"max", "or", "gt"} <= {node.operation for node in observers}
    counter, _, place, speed, *_ = loop.next_states  # the second one counts, too, but nothing reads it
    assert not {id(counter), id(place), id(speed)} & early
    order = placed_early(nodes, early)
    assert sorted(map(id, order)) == sorted(map(id, nodes))
    position = {id(node): i for i, node in enumerate(order)}
    for i, users in enumerate(users_of(nodes)):
        assert all(position[id(nodes[i])] < position[id(nodes[user])] for user in users)
    others = [node for node in nodes if id(node) not in early]
    assert [node for node in order if id(node) not in early] == others
    for node in observers:
        last_operand = max((position.get(id(operand), -1) for operand in node.operands), default=-1)
        assert all(id(between) in early for between in order[last_operand + 1 : position[id(node)]])


@pytest.mark.parametrize("lane", [chains, oscillator])
@pytest.mark.parametrize("vectors", [1, 2, 4])
def test_strict_results_do_not_depend_on_the_number_of_hardware_vectors(lane, vectors, monkeypatch):
    plain = both(lane, X, Y, strict=True)[0]
    packing = Packing(np.inf, vectors, 20)
    monkeypatch.setattr("dssc_jax.lanes.traced_lanes.PACKINGS", dict.fromkeys(PACKINGS, (packing,)))
    for one, other in zip(both(lane, X, Y, strict=True)[0], plain, strict=True):
        np.testing.assert_array_equal(one, other)
