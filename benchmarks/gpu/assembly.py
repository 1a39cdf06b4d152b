"""What NVIDIA's assembler makes of the kernels; a part of docs/performance.md.

No GPU is needed: ``ptxas`` of the package nvidia-cuda-nvcc, or of a CUDA toolkit, counts registers and spills.
"""

from pathlib import Path

import jax
import jax.numpy as jnp

from benchmarks.page import put
from benchmarks.speed.workloads import CASES, Case, study_of
from dssc_jax.core.numerics import arithmetic
from dssc_jax.engine.batching import lane_of_study
from dssc_jax.lanes.gpu import ptx
from dssc_jax.lanes.gpu.kernel_text import TracedKernel
from tests.lanes.assembler import ARCHITECTURES, assembled, version

PAGE = Path(__file__).parents[2] / "docs" / "performance.md"


def kernel(case: Case, strict: bool) -> bytes:
    """PTX of a case."""
    study = study_of(case, 1024, 10.0)
    with arithmetic(case.precision):
        number = jax.ShapeDtypeStruct((), jnp.result_type(float))
        arguments = dict.fromkeys(study.laws, number), jax.ShapeDtypeStruct((), jnp.uint32)
        return ptx.ptx(TracedKernel(lane_of_study(study), arguments, strict).text)


def table() -> str:
    """Every case on every architecture."""
    rows = [
        "| | | registers | stack, bytes | spilled, bytes | read back, bytes | threads of a multiprocessor |",
        "|---|---|---|---|---|---|---|",
    ]
    for case in CASES:
        for strict in (False, True):
            code = kernel(case, strict)
            for architecture in ARCHITECTURES:
                usage = assembled(code, architecture)
                name = f"{case.text}, strict" if strict else case.text
                cells = (name, architecture, *map(str, usage), str(usage.threads))
                rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows)


def part() -> str:
    """The part of the page."""
    language = int(ptx.FEATURES.removeprefix("+ptx")) / 10
    return f"""The same loops as [kernels of one thread a draw](gpu.md), as NVIDIA's assembler translates them. It needs
no GPU. A register has 32 bits, and a thread has at most 255. `python -m benchmarks.gpu` regenerates the table.

{table()}

ptxas {version()}, from PTX {language:.1f} for compute capability 8.0."""


def write() -> None:
    """Write the table."""
    put("kernels", part(), PAGE)
