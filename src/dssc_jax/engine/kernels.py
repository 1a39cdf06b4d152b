"""The forms in which a batch of lanes can run, and the choice between them.

On a CPU, lanes run as machine code of this package (:mod:`dssc_jax.lanes.lanes`). A program without a translation runs
as plain ``jit(vmap(lane))`` by XLA, with a warning. On a GPU, XLA advances all lanes sample by sample, or on request a
kernel of this package runs one lane in each thread (:mod:`dssc_jax.lanes.gpu`).
"""

import os
import warnings
from collections.abc import Callable, Mapping, Sequence
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
"""Starts a batch: ``(numbers by name, draw indices)``, shape (n,) each, to a function that waits for the lanes.

That function returns the results by name, shape (n,) each, and the time of :func:`time.perf_counter` at which the lanes
ended [s].
"""


class Form(StrEnum):
    """How a batch of lanes runs."""

    LANES = "lanes"  # machine code for a CPU, in fast arithmetic
    STRICT = "strict"  # as `lanes`, but without contraction of multiply-adds: the same bits on every machine
    SCAN = "scan"  # plain XLA
    GPU = "gpu"  # the program of `lanes` on an NVIDIA GPU, one lane a thread
    GPU_STRICT = "gpu-strict"  # the program of `strict` on an NVIDIA GPU


STRICT_FORMS = Form.STRICT, Form.GPU_STRICT
GPU_FORMS = Form.GPU, Form.GPU_STRICT


class KernelWarning(UserWarning):
    """Warning that a program runs as plain XLA, because it has no machine code."""


def requested_form(choice: str = "") -> str:
    """The form to use: the choice, else the environment's choice, else ``lanes`` on a CPU and ``scan`` on a GPU.

    Args:
        choice: Name of a form; empty: the environment variable :data:`KERNEL_VARIABLE` decides.

    Raises:
        ConfigError: There is no such form, or the form needs a GPU and the machine has none.
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

    Args:
        choice: Name of the form, for the message.

    Raises:
        ConfigError: The machine has no GPU that can run lanes.
    """
    try:
        return driver().name
    except GpuError as problem:
        alternative = Form.STRICT if choice in STRICT_FORMS else Form.LANES
        message = f"'{choice}' needs an NVIDIA GPU: {problem}; '{alternative}' runs on a CPU"
        raise ConfigError("kernel", message) from None


def compiler_settings() -> list[str]:
    """Settings beside versions that affect the last digits of a result: compiler, processor, GPU, requested form."""
    form = requested_form()
    requests = [f"{KERNEL_VARIABLE}={form}"] if os.environ.get(KERNEL_VARIABLE) else []
    gpus = [f"gpu {gpu_name(form)}"] if form in GPU_FORMS else []
    return [*machine.code_settings(), *gpus, *requests]


def compile_batches(
    choice: str, lane: Callable[..., Any], names: Sequence[str], lanes: int, tile: int | None, devices: int | None
) -> Start:
    """Compile the program of a lane for batches.

    Args:
        choice: The result of :func:`requested_form`.
        lane: ``(numbers by name, draw index) -> results by name``.
        names: Names of the numbers.
        lanes: Most lanes of a batch.
        tile: Lanes of a tile, for plain XLA; None: chosen from the size of the batch.
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
            warn_of_plain_xla(problem)
    return PlainBatch(lane, names, lanes, tile, devices).start


def compile_single_lane(lane: Callable[..., Any], names: Sequence[str], plain: bool = False) -> Callable[..., Any]:
    """Compile the program of a single lane, which may record arrays.

    Args:
        lane: ``(numbers by name, draw index) -> a tree of results``.
        names: Names of the numbers.
        plain: Whether to use plain XLA, as a reference.

    Returns:
        The same function of plain numbers, with results as NumPy arrays.

    Warns:
        KernelWarning: There is no machine code for the program.
    """
    number = jax.ShapeDtypeStruct((), jnp.result_type(float))
    if jax.default_backend() == "cpu" and not plain:
        try:
            lanes = compiled_lanes(lane, dict.fromkeys(names, number), jax.ShapeDtypeStruct((), jnp.uint32), width=1)

            def run_lane(values: Mapping[str, Any], index: Any) -> Any:
                """The results of the lane by machine code."""
                columns = {name: np.array([values[name]]) for name in names}
                finish = lanes.start((columns, np.array([index])), 1, 1)  # one lane, one thread
                results = finish()
                return jax.tree.map(lambda column: column[0], results)

            return run_lane
        except Unsupported as problem:
            warn_of_plain_xla(problem)
    jitted = jax.jit(lane, compiler_options=plain_options())

    def run_plain(values: Mapping[str, Any], index: Any) -> Any:
        """The results of the lane by plain XLA."""
        results = jitted({name: values[name] for name in names}, np.uint32(index))
        return jax.tree.map(np.asarray, results)

    return run_plain


def warn_of_plain_xla(problem: Unsupported) -> None:
    """Warn that a program runs as plain XLA, because an operation has no machine code."""
    warnings.warn(f"slower, by plain XLA: no machine code for {problem}", KernelWarning, stacklevel=3)
