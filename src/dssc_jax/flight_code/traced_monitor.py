"""The traced monitor of a study's flight, which is written as C and compared with it bit by bit."""

from dataclasses import dataclass
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import keystr, tree_flatten_with_path

from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.signals import Scalar
from dssc_jax.flight_code.controller import FlightCode, TracedFunction, traced_function
from dssc_jax.flight_code.monitor import ChannelSample, MonitorSample, MonitorState, initial_monitor, monitor
from dssc_jax.flight_code.premises import Premises

Tree = TypeVar("Tree", MonitorState, MonitorSample)


@dataclass(frozen=True)
class TracedMonitor:
    """A traced monitor.

    Args:
        premises: The bounds that the monitor watches, rounded outwards to the dtype of its numbers.
        prefix: Prefix of the monitor's functions and types in C.
        inputs: Names in C of the sample's numbers.
        memories: Names in C of the state's floating-point numbers, in the order of the state's leaves.
        step: ``(state, sample) -> (next state, flags of the sample)``.
        precision: Bits of a number.
    """

    premises: Premises
    prefix: str
    inputs: tuple[str, ...]
    memories: tuple[str, ...]
    step: TracedFunction
    precision: int

    @property
    def real(self) -> np.dtype:
        """The dtype of its numbers."""
        return np.dtype(f"float{self.precision}")


def traced_monitor(code: FlightCode, premises: Premises) -> TracedMonitor:
    """Trace the monitor of a study's flight, with bounds that are rounded outwards to the code's numbers.

    Args:
        code: The controllers of the study, which give the monitor its precision and the prefix of its names.
        premises: The premises of the study's certificate.
    """
    rounded_premises = premises.rounded(np.dtype(f"float{code.precision}"))

    # Generated C would repeat a docstring of this function; TracedMonitor tells what it computes.

    def step(state: MonitorState, sample: MonitorSample) -> tuple[MonitorState, Scalar]:
        after, current = monitor(rounded_premises, state, sample)
        return typed(after), current

    with arithmetic(code.precision):
        state = monitor_state(rounded_premises)
        sample = sample_shape(rounded_premises)
        traced_step, _ = traced_function(step, state, sample)
    labels = [channel.label for channel in premises.channels]
    inputs = member_names_of(sample, labels)
    memories = []
    for name, leaf in zip(member_names_of(state, labels), jax.tree.leaves(state), strict=True):
        if leaf.dtype.kind == "f":  # the others are flags and counts
            memories.append(name)
    return TracedMonitor(
        premises=rounded_premises,
        prefix=f"{code.name}_monitor",
        inputs=tuple(inputs),
        memories=tuple(memories),
        step=traced_step,
        precision=code.precision,
    )


def typed(state: MonitorState) -> MonitorState:
    """The state with arrays in place of plain numbers: integers stay integers, others get the present precision.

    Args:
        state: The state, whose leaves may be numbers of Python.
    """

    def array(leaf: Scalar) -> jax.Array:
        value = jnp.asarray(leaf)
        return value if value.dtype.kind in "iu" else value.astype(jnp.result_type(float))

    return jax.tree.map(array, state)


def monitor_state(premises: Premises) -> MonitorState:
    """The state's tree of shapes and dtypes; to be called in the arithmetic of the monitor."""
    return shapes(typed(initial_monitor(premises)))


def shapes(tree: Tree) -> Tree:
    """A tree with the shape and dtype of each scalar in its place."""
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((), leaf.dtype), tree)


def sample_shape(premises: Premises) -> MonitorSample:
    """A sample's tree of shapes and dtypes; to be called in the arithmetic of the monitor."""
    number = jnp.zeros((), jnp.result_type(float))
    channels = []
    for channel in premises.channels:
        command = () if channel.disturbance is None else number
        margin = number if channel.slides else ()
        channels.append(
            ChannelSample(y=number, y_dot=number, y_ref=number, y_ref_dot=number, u_p=command, sliding_margin=margin)
        )
    tilt = () if premises.tilt is None else number
    return shapes(MonitorSample(tuple(channels), tilt, (number,) * premises.rotor_count))


def member_names_of(tree: MonitorState | MonitorSample, labels: list[str]) -> list[str]:
    """A name in C for each leaf of a tree: the fields of its path, with a channel's label in place of its position.

    Args:
        tree: The monitor's state or its sample.
        labels: Label of each channel; empty: the names of its leaves have none.
    """
    names = []
    leaves, _ = tree_flatten_with_path(tree)
    for path, _ in leaves:
        fields = keystr(path, simple=True, separator=".").split(".")
        if fields[0] == "channels":
            _, position, *fields_in_channel = fields
            label = labels[int(position)]
            fields = [label, *fields_in_channel] if label else fields_in_channel
        elif fields[0] == "rotor":
            fields[1] = str(int(fields[1]) + 1)  # rotors count from 1
        names.append("_".join(fields))
    return names
