"""dssc-jax design: gains with a certificate from bounds, or first gains for the plant of a study."""

import json
import math
from pathlib import Path

from dssc_jax.analyses.loop_margins.designed import DesignedMargins, designed_margins
from dssc_jax.cli.analysing import save_text
from dssc_jax.cli.declarations.designs import Design
from dssc_jax.cli.designing import print_design, require_one_form
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.loading import load_study
from dssc_jax.console.loops import margin_lines
from dssc_jax.console.terminal import notify
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.toml import TomlTable
from dssc_jax.design.files import design_toml, load_design
from dssc_jax.design.first_gains import FirstController, FirstGains, first_gains
from dssc_jax.results.summary import jsonable
from dssc_jax.study import Study, read_toml
from dssc_jax.study.library import find_study
from dssc_jax.study.tables import to_toml, toml_entries


def run(options: Design) -> int:
    """Find the gains, write them to a file if one is named, and print them."""
    require_one_form(options.as_json, options.as_latex)
    if is_study(options.bounds):
        return print_first_gains(options)
    options_of_a_study = {
        "--controller": options.controller,
        "--bandwidth": options.bandwidth,
        "--limit": options.limit,
        "--at": options.at,
    }
    for name, value in options_of_a_study.items():
        if value is not None:
            raise ConfigError(name, "belongs to a study, and this file has no [plant]")
    design = load_design(options.bounds, complete=False)
    if options.out is not None:
        save_text(options.out, design_toml(design))
    return print_design(design, options.as_json, options.as_latex)


def is_study(path: Path) -> bool:
    """Whether a path leads to a study, which has a plant, and not to a file of bounds.

    Args:
        path: The file, or the name of a packaged study.

    Raises:
        ConfigError: There is no such file or study, or it is not TOML.
    """
    return "plant" in read_toml(find_study(str(path)))


def print_first_gains(options: Design) -> int:
    """Find first gains for the plant of a study, write the study with them if a file is named, and print them.

    Raises:
        ConfigError: LaTeX is requested, the study has no such gains, or the file cannot be written.
    """
    if options.as_latex:
        raise ConfigError("--latex", "prints a certificate, which first gains do not have")
    study = load_study(str(options.bounds), {}, options.allow_local, options.allow_native).without_sweep()
    kind = options.controller or FirstController.PID
    if not options.as_json:
        notify(f"{study.name}: linearising the plant and designing {kind}, which takes some seconds")
    gains = first_gains(study, kind, options.bandwidth, options.limit, options.at)
    margins = designed_margins(gains.loop, study.loop.sample_time)
    if options.out is not None:
        write_study(options.out, {**study.table, "controller": gains.table})
    if options.as_json:
        content = {
            "study": study.name,
            "bandwidth": gains.bandwidth,
            "largest_pole": gains.radius,
            "settling": gains.settling,
            "sensitivity_peak": gains.sensitivity_peak,
            "actuators": gains.linear_kinds,
            "left_out": gains.left_out,
            "margins": margins,
            "controller": gains.table,
        }
        print(json.dumps(jsonable(content), allow_nan=False))
    else:
        print("\n".join(gain_lines(study, gains, margins)))
    return DONE


def gain_lines(study: Study, gains: FirstGains, margins: DesignedMargins) -> list[str]:
    """Lines on first gains: their table, the loop's largest pole and settling time, and its margins."""
    sampling = f"T_s = {study.loop.sample_time:g} s"
    actuators = f" behind its linear actuators ({' + '.join(gains.linear_kinds)})" if gains.linear_kinds else ""
    sliding = " while it slides" if gains.table["kind"] == FirstController.SSC else ""
    decay = 0.0  # time constant of the largest pole [s]; a pole at 0 decays at once
    if gains.radius > 0.0:
        decay = study.loop.sample_time / -math.log(gains.radius)
    lines = [
        toml_entries(gains.table, "controller").strip(),
        f"\nfor {study.name} at {gains.bandwidth:.4g} rad/s, {sampling}, at the nominal plant",
        *point_lines(gains),
        f"largest pole of the sampled loop{actuators}{sliding} {gains.radius:.6g}, below 1: stable",
        f"it decays with a time constant of {decay:.3g} s; 1/bandwidth is {1.0 / gains.bandwidth:.3g} s",
        f"after a step of a disturbance at the command, y settles within 2 % of its peak in {gains.settling:.3g} s",
        f"peak of its sensitivity abs(S) {gains.sensitivity_peak:.3g}",
        *margin_lines(margins),
    ]
    if gains.left_out:
        lines.append(f"left out, so that the whole loop has less margin: {', '.join(gains.left_out)}")
    lines.append("dssc-jax loop gives the margins of the whole loop; look at them before you rely on these gains")
    return lines


def point_lines(gains: FirstGains) -> list[str]:
    """Lines on the point at which the plant was linearised; none if it is the origin."""
    resting = gains.plant.resting
    if not gains.plant.is_held:
        rule = "no command holds the plant at its start, so these are gains of a point that it leaves"
        return [f"{rule}; state an output at which it rests, --at Y, or start it at an equilibrium"]
    if resting is None or not (resting.output or resting.command or any(resting.signals)):
        return []
    point = f"linearised where it rests: y = {resting.output:.6g}, u = {resting.command:.6g}"
    signals = ", ".join(f"{value:.6g}" for value in resting.signals)
    return [f"{point}, measured signals = {signals}" if signals else point]


def write_study(out: Path, table: TomlTable) -> None:
    """Write a study with first gains.

    Args:
        out: The file.
        table: Table of the study, with the gains.

    Raises:
        ConfigError: The other sections do not fit the gains, or the file cannot be written.
    """
    try:
        Study.from_table(table)
    except ConfigError as error:
        rule = f"the study would not be valid with these gains: {error}"
        raise ConfigError("--out", f"{rule}; change that section, or copy [controller] without --out") from None
    save_text(out, to_toml(table))
