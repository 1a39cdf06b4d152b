"""Show the machine, the versions and every kind of model."""

import platform
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from dssc_jax.console.terminal import output, show_table
from dssc_jax.core import files


def machine() -> str:
    """Processor, versions and date, to be given with a measurement."""
    import jax

    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        names = [
            line.partition(":")[2].strip() for line in files.read_text(cpuinfo).splitlines() if "model name" in line
        ]
        model = f"{len(names)} cores of {names[0]}" if names else model
    return f"{model}, Python {platform.python_version()}, JAX {jax.__version__}, {datetime.now(UTC):%Y-%m-%d}"


def environment() -> dict[str, Any]:
    """Versions, devices, compiler and registries."""
    import jax

    from dssc_jax.console.kinds import kinds
    from dssc_jax.engine import forms
    from dssc_jax.study.measuring import KNOWN

    packages = ("dssc_jax", "jax", "jaxlib", "numpy", "scipy", "xarray", "zarr", "optax")
    return {
        "versions": {"python": platform.python_version(), **{name: version(name) for name in packages}},
        "devices": [str(device) for device in jax.devices()],
        "compiler": forms.compiler_settings(),
        "kinds": kinds(),
        "metrics": {
            name: {"unit": metric.unit, "meaning": metric.meaning, "of": metric.scope.value}
            for name, metric in KNOWN.items()
        },
    }


def show_environment(environment: dict[str, Any]) -> None:
    """Print the environment."""
    from dssc_jax.console.kinds import HEADS
    from dssc_jax.study.laws import LAWS

    console = output()
    console.print("  ".join(f"{name} {number}" for name, number in environment["versions"].items()))
    console.print(
        f"devices    {', '.join(environment['devices'])}\ncompiler   {', '.join(environment['compiler'])}",
        soft_wrap=True,
    )
    for slot, its_kinds in environment["kinds"].items():
        rows = []
        for kind, about in its_kinds.items():
            options = "; ".join(f"{name}: {' | '.join(map(str, values))}" for name, values in about["options"].items())
            rows.append((kind, about["summary"], ", ".join(about["fields"]), options))
        show_table((f"[{HEADS.get(slot, slot)}]", "what", "fields", "options"), rows)
    rows = [(name, about["meaning"], about["unit"], about["of"]) for name, about in environment["metrics"].items()]
    show_table(("metric", "what", "unit", "of each"), rows)
    rows = [(name, law.signature, law.rule[0]) for name, law in LAWS.items()]
    show_table(("law", "arguments", "rule"), rows)
    console.print("`dssc-jax info NAME` shows one kind's fields with unit, meaning, range and default", markup=False)
