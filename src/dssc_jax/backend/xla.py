"""CPU compiler settings, written to the environment before the XLA backend starts.

XLA:CPU runs a loop as a sequence of small kernels, each looked up, checked and called by an interpreter; a closed-loop
step has hundreds. XLA compiles a loop as a whole into one kernel if its body touches few bytes. The limit is 1 kB;
here it is raised to the size that a tile of draws needs. With this setting, 512-bit vectors if the processor supports
them, and :mod:`dssc_jax.backend.fusion`, a step costs several times less. One host device per core lets the engine
shard a batch. XLA reads the flags once, when its backend starts, so they cannot be set later or for a single
function.

The environment variable ``DSSC_JAX_XLA=off`` leaves the compiler settings unchanged.
"""

import os
import platform
import sys
import warnings
import zlib
from pathlib import Path

FLAGS_VARIABLE = "DSSC_JAX_XLA"
OFF = ("off", "0", "false")
WHOLE_LOOPS = "xla_cpu_small_while_loop_byte_threshold"
LOOP_BYTES = 4 * 2**20  # a tile of 64 UAV draws touches about half a megabyte in a step
CODE_GENERATION = (
    f"--xla_backend_extra_options={WHOLE_LOOPS}={LOOP_BYTES}",
    "--xla_cpu_prefer_vector_width=512",
)
COMPILED_FAST: dict[str, str | bool] = {"xla_backend_optimization_level": "0"}
"""Options of ``jax.jit`` for a program of one lane: its compilation takes longer than its run, so it is left simple."""
DEVICE_COUNT = "--xla_force_host_platform_device_count"


class LateSettingsWarning(UserWarning):
    """The XLA backend had started before this package could set its compiler flags."""


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def wanted_flags() -> tuple[str, ...]:
    """The flags of this package, one host device for each usable core."""
    return (*CODE_GENERATION, f"{DEVICE_COUNT}={usable_cores()}")


def flags_for(devices: int) -> str:
    """``XLA_FLAGS`` for a process like this one, with another number of host devices."""
    return " ".join([*code_generation(), f"{DEVICE_COUNT}={devices}"])


def missing_flags() -> tuple[str, ...]:
    """Those of :func:`wanted_flags` whose name is not in ``XLA_FLAGS`` yet; a user's own value takes precedence."""
    present = {flag.partition("=")[0] for flag in os.environ.get("XLA_FLAGS", "").split()}
    return tuple(flag for flag in wanted_flags() if flag.partition("=")[0] not in present)


def code_generation() -> list[str]:
    """The flags in force that change generated code, sorted; the number of host devices does not."""
    return sorted(f for f in os.environ.get("XLA_FLAGS", "").split() if not f.startswith(DEVICE_COUNT))


def compiles_loops_whole() -> bool:
    """Whether a loop over tiles becomes one kernel: on a CPU, with this package's flags in force."""
    return WHOLE_LOOPS in os.environ.get("XLA_FLAGS", "")


def backend_started() -> bool:
    """Whether JAX has started a backend in this process, after which flags have no effect."""
    bridge = sys.modules.get("jax._src.xla_bridge")
    return bridge is not None and bool(getattr(bridge, "_backends", None))


def processor() -> str:
    """A name for this processor's features: programs compiled for other processors must not be loaded."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as lines:
            known = [line for line in lines.read(2**14).splitlines() if line.startswith(("model name", "flags"))][:2]
    except OSError:
        known = [platform.processor()]
    return f"{platform.machine()}-{zlib.crc32(''.join(known).encode()):08x}"


def cache_directory() -> Path | None:
    """The folder of compiled programs; None if the user's cache directory is not writable."""
    try:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    except RuntimeError:  # no home
        return None
    existing = next(folder for folder in (home, *home.parents, Path.cwd()) if folder.exists())
    return home / "dssc_jax" / processor() if os.access(existing, os.W_OK) else None


def configure() -> None:
    """Add the missing flags to ``XLA_FLAGS``; called once, when the package is imported.

    Warns:
        LateSettingsWarning: The backend already runs without these flags.
    """
    if os.environ.get(FLAGS_VARIABLE, "").lower() in OFF:
        return
    missing = missing_flags()
    if not missing:
        return
    if backend_started():
        warnings.warn(
            "JAX started its backend before dssc_jax was imported, so the compiler flags "
            f"{' '.join(missing)} have no effect and simulations will be slower. "
            f"Import dssc_jax first, or set {FLAGS_VARIABLE}=off to do without them.",
            LateSettingsWarning,
            stacklevel=3,
        )
        return
    os.environ["XLA_FLAGS"] = " ".join([os.environ.get("XLA_FLAGS", ""), *missing]).strip()
