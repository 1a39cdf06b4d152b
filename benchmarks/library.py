"""Writes the measured part of docs/library.md: bits and rates of controllers in C. Run it as ``make library``."""

import dataclasses
import re
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import jax
import jax.numpy as jnp
import numpy as np

import dssc_jax as dj
from benchmarks.page import put
from dssc_jax.cli.native_build import build_library
from dssc_jax.closed_loop.first_state import initial_state
from dssc_jax.closed_loop.sample import held_between_samples, step
from dssc_jax.core.native.libraries import NativeLibrary
from dssc_jax.core.numerics import arithmetic
from dssc_jax.engine.batching import Engine, lanes_of, values_of_draws
from dssc_jax.engine.sampling import draw, draw_key
from dssc_jax.flight_code.controller import study_values
from dssc_jax.flight_code.folder import FlightFolder
from dssc_jax.lanes.lanes import CompiledLanes

PAGE = Path(__file__).parents[1] / "docs" / "library.md"
STUDIES = ("mu_robustness", "noise_robustness", "motor", "uav_robustness")
SAMPLES = 10_000_000
"""Samples of each study's controllers that are compared, over all channels."""
LENGTH = 1000
"""Samples of a draw."""
BATCH = 512
"""Draws that are recorded together."""
RATE_DRAWS = 1024
REFERENCE_DRAWS = 16


def library_of(study: dj.Study, folder: Path) -> tuple[NativeLibrary, dict[str, float]]:
    """The study's controllers, generated as C, built and loaded; the study's numbers of them."""
    generated = FlightFolder(study)
    for name, text in generated.texts().items():
        (folder / name).write_text(text)
    file = folder / f"{generated.code.name}.so"
    file.write_bytes(build_library([folder / f"{generated.code.name}_controller.c"], []))
    return dj.allow_native(file), study_values(generated.code.controllers)


def with_library(study: dj.Study, library: NativeLibrary) -> dj.Study:
    """The study with its own controllers in C; their code contains the differentiators."""
    controller: dict[str, object] = {"kind": "library", "file": library.file, "sha256": library.sha256}
    channels = study.loop.plant.channels
    for channel, exported in zip(channels, library.controllers, strict=bool(channels)):
        controller[channel] = {"name": exported.name}
    if channels:
        controller["name"] = library.controllers[0].name
    kept = {name: value for name, value in study.table.items() if name not in ("sweep", "tune", "compare")}
    requirements = {"requirement": [], "metrics": {"names": ["error_rms", "command_tv"]}}
    return dj.Study.from_table({**kept, **requirements, "controller": controller, "differentiator": {"kind": "none"}})


def command_lanes(study: dj.Study, constants: dict[str, float], samples: int) -> CompiledLanes:
    """The program of a draw in strict arithmetic that records what every controller reads and gives, sample by sample.

    In float32, numbers that are inputs of the program are rounded at other places than numbers that are compiled in.
    Those of a controller (``constants``) are therefore inputs, as they are in C.
    """
    loop = dataclasses.replace(study.loop, steps=samples)

    def lane(values, index):
        params = study.params(values)
        key = draw_key(study.config.seed, index)
        advance = held_between_samples(loop, params)

        def sample(carry, _):
            state, k = carry
            after, recorded = step(loop, params, key, state, k, advance)
            rows = [(*x.reading, x.command.robust, x.command.nominal) for x in recorded.controlled]
            return (after, k + 1), jax.tree.map(lambda x: jnp.asarray(x, jnp.result_type(float)), rows)

        return jax.lax.scan(sample, (initial_state(loop, params, key), jnp.zeros((), jnp.int32)), length=samples)[1]

    number = jax.ShapeDtypeStruct((), jnp.result_type(float))
    names = [*study.laws, *constants]
    return CompiledLanes(lane, dict.fromkeys(names, number), jax.ShapeDtypeStruct((), jnp.uint32), strict=True)


def compared(name: str, folder: Path) -> tuple[str, dj.Study]:
    """The row of a study in the table of bits, and the study with its controllers in C."""
    study = dj.Study.load(name).without_sweep()
    library, constants = library_of(study, folder)
    native = with_library(study, library)
    constants = {key: value for key, value in constants.items() if key not in study.laws}
    native_laws = {key: law for key, law in study.laws.items() if key in native.laws}
    if native_laws.keys() != study.laws.keys():
        raise SystemExit(f"{name}: its controllers have laws, which the library's would need, too")
    channels = len(study.loop.channels)
    draws = -(-SAMPLES // (LENGTH * channels))
    differing = values = 0
    broken = 0
    with arithmetic():
        ours, theirs = command_lanes(study, constants, LENGTH), command_lanes(native, {}, LENGTH)
        for first in range(0, draws, BATCH):
            indices = np.arange(first, min(first + BATCH, draws))
            drawn_values = draw(study, indices)
            extra = {key: np.full(len(indices), value) for key, value in constants.items()}
            left = jax.tree.leaves(ours.start((drawn_values | extra, indices), len(indices), 2)())
            right = jax.tree.leaves(theirs.start((drawn_values, indices), len(indices), 2)())
            for a, b in zip(left, right, strict=True):
                differing += int(np.sum(a.view(np.uint64) != b.view(np.uint64)))
                values += a.size
                broken += int(np.sum(~np.isfinite(a)))
    samples = draws * LENGTH * channels
    print(name, samples, values, differing, broken, flush=True)
    kinds = study.config.controller["kind"]
    return f"| `{name}` | {kinds} | {channels} | {samples:,} | {values:,} | {differing} |", native


def rate(study: dj.Study, kernel: str, draws: int) -> float:
    """Samples of all channels that a second of processor time advances, without compilation."""
    engine = Engine(study, draws, kernel=kernel)
    block = (slice(0, draws),)
    values = values_of_draws(study, block[-1])
    engine(*lanes_of(study, block, values))()
    began = time.process_time()
    engine(*lanes_of(study, block, values))()
    return draws * study.loop.steps * len(study.loop.channels) / (time.process_time() - began)


def example_study(folder: Path) -> dj.Study:
    """The study of the page's own example."""
    text = PAGE.read_text()
    for language, name in (("c", "velocity.c"), ("toml", "velocity.toml")):
        (block,) = [part for part in re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL) if name in part[:20]]
        (folder / name).write_text(block)
    (folder / "velocity.so").write_bytes(build_library([folder / "velocity.c"], []))
    dj.allow_native(folder / "velocity.so")
    return dj.Study.load(folder / "velocity.toml")


def rate_row(name: str, study: dj.Study, own: dj.Study | None) -> str:
    """The row of a study in the table of rates."""
    compiled = rate(study, "lanes", RATE_DRAWS // len(study.loop.channels))
    plain = rate(study, "scan", REFERENCE_DRAWS)
    ours = "" if own is None else f"{rate(own, 'lanes', RATE_DRAWS // len(own.loop.channels)) / 1e6:.2f}"
    print(name, compiled, plain, ours, flush=True)
    return f"| {name} | {compiled / 1e6:.2f} | {plain / 1e6:.3f} | {ours} |"


def main() -> None:
    """Measure and write both tables."""
    bits = ["| study | controller | channels | samples | values | differing |", "|---|---|---|---|---|---|"]
    head = "million samples a second and core"
    rates = [
        f"| loop | C, {head} | C through a callback, plain XLA | the package's own controller |",
        "|---|---|---|---|",
    ]
    with TemporaryDirectory() as folder:
        rates.append(rate_row("`velocity.c` above", example_study(Path(folder)), None))
        for name in STUDIES:
            row, native = compared(name, Path(folder))
            bits.append(row)
            own = dj.Study.load(name).without_sweep()
            rates.append(rate_row(f"`{name}`, its controllers generated as C", native, own))
    rows = "\n".join(bits), "\n".join(rates)
    put("measured", "\n\n".join(rows), PAGE)


if __name__ == "__main__":
    main()
