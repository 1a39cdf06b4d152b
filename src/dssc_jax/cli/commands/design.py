"""dssc-jax design: gains with a certificate from bounds, or first gains for the plant of a study."""

import json
import math
from pathlib import Path

from dssc_jax.cli.analysing import attempt
from dssc_jax.cli.declarations.designs import Design
from dssc_jax.cli.designing import print_design, require_one_form
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.loading import load_study
from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.design.files import design_toml, load_design
from dssc_jax.design.first_gains import FirstController, first_gains
from dssc_jax.results.summary import jsonable
from dssc_jax.study import read_toml
from dssc_jax.study.actuators import SLOT, kind_in
from dssc_jax.study.library import find
from dssc_jax.study.tables import to_toml, toml_entries


def run(options: Design) -> int:
    """Find the gains, write the file if one is named, and print them."""
    require_one_form(options.as_json, options.as_latex)
    if is_study(options.bounds):
        return print_first_gains(options)
    options_set = {"--controller": options.controller, "--bandwidth": options.bandwidth, "--limit": options.limit}
    for name, value in options_set.items():
        if value is not None:
            raise ConfigError(name, "belongs to a study, and this file has no [plant]")
    design = load_design(options.bounds, complete=False)
    if options.out is not None:
        out = options.out
        attempt(out, lambda: files.write_text(out, design_toml(design)))
    return print_design(design, options.as_json, options.as_latex)


def is_study(path: Path) -> bool:
    """Whether a name is that of a packaged study, or a file with a plant."""
    file = find(str(path))
    return "plant" in read_toml(file)


def print_first_gains(options: Design) -> int:
    """Find the first gains for a study, write the study with them, and print them."""
    if options.as_latex:
        raise ConfigError("--latex", "prints a certificate, which first gains do not have")
    study = load_study(str(options.bounds), {}, local=options.allow_local).without_sweep()
    found = first_gains(study, options.controller or FirstController.PID, options.bandwidth, options.limit)
    if options.out is not None:
        out = options.out
        text = to_toml({**study.table, "controller": found.table})
        attempt(out, lambda: files.write_text(out, text))
    actuators = kind_in(study.config, SLOT)
    if options.as_json:
        content = {"study": study.name, "bandwidth": found.bandwidth, "largest_pole": found.radius}
        content |= {"actuators_left_out": actuators}
        print(json.dumps(jsonable({**content, "controller": found.table}), allow_nan=False))
        return DONE
    print(toml_entries(found.table, "controller").strip())
    sampled = f"T_s = {study.loop.sample_time:g} s"
    print(f"\nfor {study.name} at {found.bandwidth:.4g} rad/s, {sampled}, at the nominal plant")
    remark = "" if actuators == "none" else f" without its actuators ({actuators})"
    if not math.isnan(found.radius):
        print(f"largest pole of the sampled loop{remark} {found.radius:.6g}, below 1: stable")
    print("dssc-jax loop gives the margins of the whole loop; look at them before you rely on these gains")
    return DONE
