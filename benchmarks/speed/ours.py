"""The package's own engine on a task's draws, and the form that one would write first: ``jit(vmap(scan))``."""

import time
from collections.abc import Callable, Mapping

import jax
import numpy as np

import dssc_jax as dj
from benchmarks.speed.workloads import METRICS, Found, Task
from dssc_jax.core.signals import Outcome
from dssc_jax.engine.batching import Engine, lane_of_study

Program = Callable[[], Found]


def gather(study: dj.Study, arrays: dict[str, np.ndarray]) -> Found:
    """Results by name as every program gives them."""
    channels = study.loop.plant.channels or ("",)
    names = [[f"{metric}_{channel}" if channel else metric for channel in channels] for metric in METRICS]
    outcome, steps = np.asarray(arrays["outcome"]), study.loop.steps
    ended = np.round(np.nan_to_num(arrays["failed_at"]) / study.loop.sample_time).astype(int) - 1
    metrics = np.array([[arrays[name] for name in row] for row in names])
    return Found(metrics, outcome, np.where(outcome == Outcome.OK, steps, ended))


def tiled(task: Task, devices: int | None = None) -> tuple[Program, Engine]:
    """The engine on a task's draws, and itself; each call runs it, the first one compiles."""
    count = task.study.config.draws
    engine = Engine(task.study, count, devices=devices)
    values = dict(zip(engine.names, task.drawn(engine.names), strict=True))
    return lambda: gather(task.study, engine(values, np.arange(count))()), engine


def plain(task: Task, options: Mapping[str, str | bool] | None = None) -> tuple[Program, float]:
    """``jit(vmap(scan))`` over all draws at once, and the seconds that its compilation took; each call runs it."""
    study, lane = task.study, lane_of_study(task.study, axis_name=None)
    names = list(study.laws)
    precise = jax.enable_x64(task.case.precision == 64)
    began = time.perf_counter()
    with precise:
        values = {name: jax.numpy.asarray(column, float) for name, column in zip(names, task.drawn(names), strict=True)}
        index = jax.numpy.arange(study.config.draws, dtype=jax.numpy.uint32)
        compiled = jax.jit(jax.vmap(lane)).lower(values, index).compile(options and dict(options))
    seconds = time.perf_counter() - began

    def call() -> Found:
        return gather(study, jax.tree.map(np.asarray, compiled(values, index)))

    return call, seconds
