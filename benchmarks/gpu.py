"""Measure a GPU and write what was found into docs/gpu.md: ``python benchmarks/gpu.py``.

* the scan form and the Pallas kernel, interleaved, in lane-steps a second (one draw advanced by one sample), transfers
  of draws and results included;
* the floor of the scan form: the state of every lane is read and written at every sample, at the bandwidth of a copy;
* the largest difference of the kernel's results from the CPU's.

``--compile`` needs no GPU, but the package ``triton``: it takes the kernels to machine code, and tells how many
registers and how much memory a thread needs. ``--rehearse`` does everything but that on a few lanes of whatever JAX
finds, and writes nothing.
"""

import argparse
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.interpreters import mlir
from page import put

import dssc_jax as dj
from dssc_jax.closed_loop.metrics import starts
from dssc_jax.closed_loop.sample import initial_state
from dssc_jax.engine.batching import Engine, drawn, lane_of_study, medians
from dssc_jax.lanes.forms import Form
from dssc_jax.lanes.interface import AXIS
from dssc_jax.lanes.kernels import LANES, WARPS, in_registers
from dssc_jax.study.library import find

PAGE = Path(__file__).parents[1] / "docs" / "gpu.md"
ARCHITECTURE = 90  # compute capability 9.0: the least that JAX lowers for where there is no GPU
COPIED = 2**30  # bytes
WIDTHS = (2**15, 2**18)  # lanes
COMPARED = 1024  # lanes
PRECISIONS = (64, 32)


def axis() -> dj.Study:
    """1-DOF DSSC with lag, 2000 samples."""
    study = dj.Study.load(find("mu_robustness")).without_sweep()
    return study.override({"loop.duration": 10.0, "requirement": [], "controller.predictor_start": "matched"})


def flight() -> dj.Study:
    """The full UAV of the article's Case 1 from uncertain places in uncertain wind, 1000 samples."""
    changes: dict[str, Any] = {
        "loop.duration": 5.0,
        "requirement": [],
        "plant.position": [{"uniform": [38.0, 42.0]}, {"uniform": [8.0, 12.0]}, 10.0],
        "wind": {"kind": "constant", "x": {"uniform": [6.0, 10.0]}, "y": -8.0, "z": 8.0, "at": 1.0},
    }
    return dj.Study.load(find("paper_case1")).override(changes)


CASES = {"1-DOF DSSC": axis, "full UAV": flight}


def lanes_of(study: dj.Study) -> Any:
    """The study's program for many lanes."""
    return jax.vmap(lane_of_study(study), axis_name=AXIS)


def state_numbers(study: dj.Study) -> int:
    """How many numbers a lane carries from sample to sample."""
    state = jax.eval_shape(lambda key: initial_state(study.loop, study.params(medians(study)), key), jax.random.key(0))
    return len(jax.tree.leaves((state, starts(study.measures))))


FORMS = Form.SCAN, Form.PALLAS


class Measured(NamedTuple):
    """Lane-steps a second and seconds of compiling, by form."""

    rate: dict[Form, float]
    compiling: dict[Form, float]


def measured(study: dj.Study, lanes: int, repeats: int) -> Measured:
    """Both forms in turn, one wide tile each; medians."""
    values, indices = drawn(study, slice(0, lanes)), np.arange(lanes)
    engines = {form: Engine(study, lanes, tile=lanes, devices=1, kernel=form) for form in FORMS}
    seconds: dict[Form, list[float]] = {form: [] for form in FORMS}
    for turn in range(repeats + 1):
        for form, engine in engines.items():
            before = engine.clock.run_seconds
            engine(values, indices)()
            if turn:
                seconds[form].append(engine.clock.run_seconds - before)
    return Measured(
        {form: lanes * study.loop.steps / median(times) for form, times in seconds.items()},
        {form: engine.clock.compile_seconds for form, engine in engines.items()},
    )


def bandwidth(size: int, repeats: int) -> float:
    """Bytes a second, read and written, of x + 1 over ``size`` bytes; the median."""
    numbers, seconds = jnp.ones(size // 4, jnp.float32), []
    copy = jax.jit(lambda x: x + 1.0)
    copy(numbers).block_until_ready()
    for _ in range(repeats):
        began = time.perf_counter()
        copy(numbers).block_until_ready()
        seconds.append(time.perf_counter() - began)
    return 2 * numbers.nbytes / median(seconds)


def floor(study: dj.Study, bytes_a_second: float) -> float:
    """Lane-steps a second at which a scan over all lanes does nothing but read and write the state."""
    return bytes_a_second / (2 * state_numbers(study) * study.config.loop.precision / 8)


def difference(study: dj.Study, lanes: int) -> tuple[float, int]:
    """The kernel on this device against the scan on the CPU.

    Returns:
        The largest difference of a metric over the metric's largest magnitude, among draws that end alike; and how
        many draws do not.
    """
    values, indices = drawn(study, slice(0, lanes)), np.arange(lanes, dtype=np.uint32)
    here = Engine(study, lanes, tile=lanes, devices=1, kernel=Form.PALLAS)(values, indices)()
    with jax.enable_x64(study.config.loop.precision == 64), jax.default_device(jax.devices("cpu")[0]):
        typed = {name: column.astype(jnp.result_type(float)) for name, column in values.items()}
        there = {name: np.asarray(x) for name, x in jax.jit(lanes_of(study))(typed, indices).items()}
    alike = here["outcome"] == there["outcome"]
    largest = 0.0
    for name in {measure.name for measure in study.measures}:
        a, b = here[name][alike], there[name][alike]
        if np.isfinite(b).any():
            gap, scale = float(np.nanmax(np.abs(a - b))), float(np.nanmax(np.abs(b)))
            largest = max(largest, gap / scale if scale else gap)
    return largest, int(np.sum(~alike))


def table(cases: dict[str, dj.Study], widths: tuple[int, ...], compared: int, copied: int, repeats: int) -> str:
    """Everything, as Markdown."""
    speed = bandwidth(copied, repeats)
    lines = [
        f"Device: {jax.devices()[0].device_kind}, one of {len(jax.devices())}. A copy moves {speed / 1e9:.0f} GB/s, "
        f"read and written. Rates in millions of lane-steps a second, medians of {repeats}; compiling in seconds.",
        "",
        "| study | precision | lanes | scan | scan's floor | kernel | kernel/scan | compiling: scan, kernel |",
        "|---|---|---|---|---|---|---|---|",
    ]
    compare = []
    for name, whole in cases.items():
        for precision in PRECISIONS:
            study = whole.override({"loop.precision": precision})
            for lanes in widths:
                rate, compiling = measured(study, lanes, repeats)
                cells = [f"{x / 1e6:.1f}" for x in (rate[Form.SCAN], floor(study, speed), rate[Form.PALLAS])]
                lines.append(
                    f"| {name} | float{precision} | {lanes} | {' | '.join(cells)} | "
                    f"{rate[Form.PALLAS] / rate[Form.SCAN]:.2f} | "
                    f"{compiling[Form.SCAN]:.1f}, {compiling[Form.PALLAS]:.1f} |"
                )
            largest, unlike = difference(study, compared)
            compare.append(f"* {name}, float{precision}: largest difference {largest:.1e}; {unlike} end otherwise.")
    text = f"The kernel against the CPU, {compared} draws, relative to each metric's largest value:"
    return "\n".join([*lines, "", text, "", *compare])


def lowered(study: dj.Study) -> Any:
    """The kernel of a study, lowered for CUDA without a device; from 0.11 on JAX lowers it only where there is one."""
    with jax.enable_x64(study.config.loop.precision == 64):
        numbers = {name: jnp.zeros(LANES) for name in study.laws}
        run = jax.jit(in_registers(lanes_of(study), interpret=False))
        return run.trace(numbers, jnp.arange(LANES, dtype=jnp.uint32)).lower(lowering_platforms=("cuda",))


def triton_module(study: dj.Study) -> str:
    """The kernel of a study as Triton's intermediate text, lowered for CUDA without a device."""
    from jaxlib.mlir import ir
    from jaxlib.triton import dialect

    found: list[bytes] = []

    def visit(operation: Any) -> Any:
        if "triton" in str(operation.attributes.get("call_target_name", "")):
            found.append(operation.attributes["mhlo.backend_config"]["ir"].value_bytes)
        return ir.WalkResult.ADVANCE

    module: Any = lowered(study).compiler_ir()
    module.operation.walk(visit)
    with mlir.make_ir_context() as context:
        dialect.register_dialect(context)
        context.load_all_available_dialects()
        return str(ir.Module.parse(found[0]).operation.get_asm(enable_debug_info=False))


def machine_code(study: dj.Study) -> tuple[int, int, float]:
    """Registers and bytes of stack of a thread, and the seconds of Triton's compiler."""
    import triton
    from triton.backends.compiler import GPUTarget

    with tempfile.TemporaryDirectory() as folder:
        source, code = Path(folder) / "kernel.ttir", Path(folder) / "kernel.cubin"
        source.write_text(triton_module(study))
        began = time.perf_counter()
        options = {"num_warps": WARPS, "num_stages": 1}
        compiled = triton.compile(str(source), target=GPUTarget("cuda", ARCHITECTURE, 32), options=options)
        seconds = time.perf_counter() - began
        code.write_bytes(compiled.asm["cubin"])
        tool = Path(triton.__file__).parent / "backends" / "nvidia" / "bin" / "cuobjdump"
        told = subprocess.run([tool, "-res-usage", code], check=True, capture_output=True, text=True).stdout
    registers, stack = (int(re.search(rf"{what}:(\d+)", told)[1]) for what in ("REG", "STACK"))  # type: ignore[index]
    return registers, stack, seconds


def compiled_table() -> str:
    """Machine code of both studies in both precisions, as Markdown."""
    import triton

    lines = [
        f"Triton {triton.__version__}, compute capability {ARCHITECTURE / 10:.1f}, {LANES} lanes and {WARPS} warp "
        "a program. A thread has 255 registers of 4 bytes at most.",
        "",
        "| study | precision | numbers of a lane's state | registers per thread | bytes of stack | compilation [s] |",
        "|---|---|---|---|---|---|",
    ]
    for name, case in CASES.items():
        for precision in PRECISIONS:
            study = case().override({"loop.precision": precision})
            registers, stack, seconds = machine_code(study)
            numbers = state_numbers(study)
            lines.append(f"| {name} | float{precision} | {numbers} | {registers} | {stack} | {seconds:.1f} |")
    return "\n".join(lines)


def refuse(reason: str) -> int:
    print(f"benchmarks/gpu.py: {reason}", file=sys.stderr)
    return 2


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--compile", action="store_true", help="to machine code, without a GPU")
    what.add_argument("--rehearse", action="store_true", help="on a few lanes of any device, writing nothing")
    asked = parser.parse_args(arguments)
    if asked.rehearse:
        short = {name: case().override({"loop.duration": 0.25}) for name, case in CASES.items()}
        print(table(short, widths=(64,), compared=64, copied=2**20, repeats=1))
        return 0
    if asked.compile:
        try:
            put("compiled", compiled_table(), PAGE)
        except ModuleNotFoundError as error:
            return refuse(f"--compile needs the package triton ({error})")
        return 0
    if jax.default_backend() != "gpu":
        return refuse(f"needs a GPU, and JAX finds none, only '{jax.default_backend()}'")
    put("measured", table({name: case() for name, case in CASES.items()}, WIDTHS, COMPARED, COPIED, repeats=5), PAGE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
