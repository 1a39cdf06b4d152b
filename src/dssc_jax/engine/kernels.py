"""The forms in which a batch of lanes can run, and the choice between them.

On a CPU, lanes run as machine code of this package (:mod:`dssc_jax.lanes.lanes`). What cannot be translated runs as
plain ``jit(vmap(lane))`` by XLA, with a warning. On a GPU, XLA advances all lanes sample by sample, or on request a
kernel of this package runs one lane in each thread (:mod:`dssc_jax.lanes.gpu`).
"""

import os
import warnings
from collections.abc import Callable, Sequence
from enum import StrEnum
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.engine.compiled_lanes import LaneBatch, compiled_lanes
from dssc_jax.engine.plain import PlainBatch, plain_options
from dssc_jax.lanes.gpu.driver import GpuError, driver
from dssc_jax.lanes.llvm import machine
from dssc_jax.lanes.unsupported import Unsupported

KERNEL_VARIABLE = "DSSC_JAX_KERNEL"
Start = Callable[[dict[str, np.ndarray], np.ndarray], Callable[[], tuple[dict[Any, np.ndarray], float]]]
"""(columns of numbers, draw indices) -> a function that waits for the results.

They are columns of the same length, beside the time of :func:`time.perf_counter` at which the lanes ended.
"""


class Form(StrEnum):
    """How a batch runs.

    ``lanes``: machine code for a CPU, in fast arithmetic. ``strict``: the same without contraction, with the same bits
    on every machine. ``scan``: plain XLA. ``gpu`` and ``gpu-strict``: the program of ``lanes`` and ``strict`` on an
    NVIDIA GPU, one lane a thread.
    """

    LANES = "lanes"
    STRICT = "strict"
    SCAN = "scan"
    GPU = "gpu"
    GPU_STRICT = "gpu-strict"


STRICT_FORMS = Form.STRICT, Form.GPU_STRICT
GPU_FORMS = Form.GPU, Form.GPU_STRICT


class KernelWarning(UserWarning):
    """A study runs in a slower form than its machine could."""


def requested_form(choice: str = "") -> str:
    """The requested form, from the argument or the environment.

    Without a request it is ``lanes`` on a CPU and ``scan`` on a GPU.

    Raises:
        ConfigError: There is no such form, or the machine has no GPU for it.
    """
    choice = choice or os.environ.get(KERNEL_VARIABLE, "")
    if not choice:
        return Form.LANES if jax.default_backend() == "cpu" else Form.SCAN
    if choice not in tuple(Form):
        *first_forms, last = tuple(Form)
        raise ConfigError(
            "kernel", f"must be {', '.join(first_forms)} or {last}, got '{choice}'; {nearest(choice, tuple(Form))}"
        )
    if choice in GPU_FORMS:
        gpu_name(choice)
    return choice


def gpu_name(choice: str) -> str:
    """Name of the GPU that a form runs on.

    Raises:
        ConfigError: The machine has none that can run lanes.
    """
    try:
        return driver().name
    except GpuError as problem:
        alternative = Form.STRICT if choice in STRICT_FORMS else Form.LANES
        message = f"'{choice}' needs an NVIDIA GPU: {problem}; '{alternative}' runs on a CPU"
        raise ConfigError("kernel", message) from None


def compiler_settings() -> list[str]:
    """Settings beside the versions that affect the last digits of a result: the compiler, the processor, a request."""
    form = requested_form()
    requests = [f"{KERNEL_VARIABLE}={form}"] if os.environ.get(KERNEL_VARIABLE) else []
    gpus = [f"gpu {gpu_name(form)}"] if form in GPU_FORMS else []
    return [*machine.code_settings(), *gpus, *requests]


def compiled(
    choice: str, lane: Callable[..., Any], names: Sequence[str], lanes: int, tile: int | None, devices: int | None
) -> Start:
    """Compile the program of a lane for batches.

    Args:
        choice: The result of :func:`requested_form`.
        lane: (numbers by name, draw index) -> results of one lane.
        names: Names of the numbers.
        lanes: Most lanes of a batch.
        tile: Lanes of a tile, for the forms of XLA.
        devices: Cores of a CPU, or GPUs; None: all.

    Raises:
        ConfigError: Strict arithmetic or a GPU's kernel was requested, and cannot express the program.

    Warns:
        KernelWarning: The program runs in a slower form.
    """
    if choice != Form.SCAN:
        strict = choice in STRICT_FORMS
        gpu = choice in GPU_FORMS
        try:
            return LaneBatch(lane, names, devices, strict, gpu).start
        except Unsupported as problem:
            if gpu:
                raise ConfigError("kernel", f"a kernel cannot express {problem}") from None
            if strict:
                raise ConfigError("kernel", f"strict arithmetic cannot express {problem}") from None
            slower(f"no machine code for {problem}")
    return PlainBatch(lane, names, lanes, tile, devices).start


def compiled_single(lane: Callable[..., Any], names: Sequence[str], plain: bool = False) -> Callable[..., Any]:
    """Compile the program of one lane, which may record arrays.

    Args:
        lane: (numbers by name, draw index) -> a tree of results.
        names: Names of the numbers.
        plain: By plain XLA.

    Returns:
        The same function for numbers, with results as NumPy arrays.

    Warns:
        KernelWarning: There is no machine code for the program.
    """
    number = jax.ShapeDtypeStruct((), jnp.result_type(float))
    if jax.default_backend() == "cpu" and not plain:
        try:
            compiled = compiled_lanes(lane, dict.fromkeys(names, number), jax.ShapeDtypeStruct((), jnp.uint32), width=1)
            return lambda values, index: jax.tree.map(
                lambda column: column[0],
                compiled.start(({name: np.array([values[name]]) for name in names}, np.array([index])), 1, 1)(),
            )
        except Unsupported as problem:
            slower(f"no machine code for {problem}")
    jitted = jax.jit(lane, compiler_options=plain_options())
    return lambda values, index: jax.tree.map(
        np.asarray, jitted({name: values[name] for name in names}, np.uint32(index))
    )


def slower(reason: str) -> None:
    """Warn that a program runs as plain XLA."""
    warnings.warn(f"slower, by plain XLA: {reason}", KernelWarning, stacklevel=3)
