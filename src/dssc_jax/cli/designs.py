"""Commands on the theorem: check, design."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dssc_jax.cli import options as opt
from dssc_jax.cli.common import DONE, FAILS, app, attempt
from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError

if TYPE_CHECKING:
    from dssc_jax.design.files import DesignFile

LatexOption = Annotated[bool, typer.Option("--latex", help="Print the tables as LaTeX (booktabs).")]


@app.command()
def check(
    design: Annotated[
        Path, typer.Argument(metavar="DESIGN", help="A design file: [bounds] with [parameters], [free] or [goal].")
    ],
    as_json: opt.Json = False,
    as_latex: LatexOption = False,
) -> int:
    """Check a design against Theorem 1: exit 1 where it is not certified.

    Table 1's inequalities must hold strictly over the whole interval of k_p, and phi_b must meet the small-gain
    condition. Tells each slack, the guaranteed residual and decay rate, and the sampling period that the design needs.
    """
    from dssc_jax.design.files import load_design

    require_one_form(as_json, as_latex)
    return output_design(load_design(design), as_json, as_latex)


@app.command()
def design(
    bounds: Annotated[Path, typer.Argument(metavar="BOUNDS", help="A file with [bounds]; [free], [goal] as wanted.")],
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE", help="Write the design file.")] = None,
    as_json: opt.Json = False,
    as_latex: LatexOption = False,
) -> int:
    """Find gains with a certificate from bounds.

    [free] fixes free parameters of Table 1; what it leaves open is chosen for the [goal]: without one, for the
    smallest guaranteed error at a sampling period of 1 ms.
    """
    from dssc_jax.design.files import design_toml, load_design

    require_one_form(as_json, as_latex)
    bounded = load_design(bounds, complete=False)
    if out is not None:
        attempt(out, lambda: files.write_text(out, design_toml(bounded)))
    return output_design(bounded, as_json, as_latex)


def require_one_form(as_json: bool, as_latex: bool) -> None:
    """Require at most one output format on stdout.

    Raises:
        ConfigError: both are requested.
    """
    if as_json and as_latex:
        raise ConfigError("--latex", "cannot be combined with --json: each is the only output on stdout")


def output_design(design_file: "DesignFile", as_json: bool, as_latex: bool) -> int:
    """Print a design with its certificate; the exit code says whether it is certified."""
    from dssc_jax.console.designs import latex, show
    from dssc_jax.design import check as check_design
    from dssc_jax.design.feasibility import limits
    from dssc_jax.results.summary import jsonable

    certificate = check_design(design_file.parameters, design_file.bounds)
    reach = limits(design_file.parameters, design_file.bounds) if certificate.certified else None
    if as_json:
        content = {
            "design": design_file.name,
            "parameters": design_file.parameters._asdict(),
            "free": design_file.free and design_file.free._asdict(),
            "goal": design_file.goal and design_file.goal._asdict(),
            "edges": design_file.edges,
            **certificate.to_dict(),
            "limits": reach and reach._asdict(),
            "modulation": design_file.modulation
            and {
                "needed_rho": design_file.modulation.needed_rho(certificate.practice),
                "first_sliding": design_file.modulation.first_sliding,
            },
        }
        print(json.dumps(jsonable(content), allow_nan=False))
    elif as_latex:
        print(latex(design_file, certificate))
    else:
        show(design_file, certificate, reach)
    return DONE if certificate.certified else FAILS
