"""Describe and print the machine, the versions of packages, and every kind of model."""

import platform
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TypedDict

import jax

from dssc_jax.console.kinds import HEADS, KindDescription, MetricDescription, kinds, metric_description
from dssc_jax.console.terminal import show_line, show_paragraph, show_table
from dssc_jax.core import files
from dssc_jax.engine import kernels
from dssc_jax.study.available_metrics import PACKAGE_METRICS
from dssc_jax.study.laws import LAWS


class Environment(TypedDict):
    """What ``dssc-jax info --json`` prints.

    Args:
        versions: Version of Python and of each package.
        devices: Devices on which JAX computes.
        compiler: Settings of the compiler.
        kinds: Kinds of models and parts, by table and name.
        metrics: Metrics by name.
    """

    versions: dict[str, str]
    devices: list[str]
    compiler: list[str]
    kinds: dict[str, dict[str, KindDescription]]
    metrics: dict[str, MetricDescription]


def machine() -> str:
    """Describe processor, versions of Python and JAX, and date in one line, to accompany a measurement."""
    processor = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        core_models = []
        for line in files.read_text(cpuinfo).splitlines():
            if "model name" in line:
                core_models.append(line.partition(":")[2].strip())
        if core_models:
            processor = f"{len(core_models)} cores of {core_models[0]}"
    return f"{processor}, Python {platform.python_version()}, JAX {jax.__version__}, {datetime.now(UTC):%Y-%m-%d}"


def environment() -> Environment:
    """Collect versions, devices, compiler settings, and the registries of kinds and metrics."""
    metrics = {name: metric_description(metric) for name, metric in PACKAGE_METRICS.items()}
    packages = ("dssc_jax", "jax", "jaxlib", "numpy", "scipy", "xarray", "zarr", "optax")
    return {
        "versions": {"python": platform.python_version(), **{name: version(name) for name in packages}},
        "devices": [str(device) for device in jax.devices()],
        "compiler": kernels.compiler_settings(),
        "kinds": kinds(),
        "metrics": metrics,
    }


def show_environment(description: Environment) -> None:
    """Print versions, devices and compiler, then tables of all kinds, metrics and laws."""
    show_paragraph("  ".join(f"{name} {number}" for name, number in description["versions"].items()))
    show_line(f"devices    {', '.join(description['devices'])}")
    show_line(f"compiler   {', '.join(description['compiler'])}")
    for slot, descriptions in description["kinds"].items():
        rows = []
        for kind, entry in descriptions.items():
            options = []
            for name, values in entry["options"].items():
                options.append(f"{name}: {' | '.join(map(str, values))}")
            rows.append((kind, entry["summary"], ", ".join(entry["fields"]), "; ".join(options)))
        show_table((f"[{HEADS.get(slot, slot)}]", "what", "fields", "options"), rows)
    rows = [(name, metric["meaning"], metric["unit"], metric["of"]) for name, metric in description["metrics"].items()]
    show_table(("metric", "what", "unit", "of each"), rows)
    rows = [(name, law.signature, law.rule[0]) for name, law in LAWS.items()]
    show_table(("law", "arguments", "rule"), rows)
    show_paragraph("`dssc-jax info NAME` shows one kind's fields with unit, meaning, range and default")
