"""Steps that the commands check and design share: print a design with its certificate."""

import json
from typing import NamedTuple

from dssc_jax.cli.exit_codes import DONE, FAILS
from dssc_jax.console.designs import latex, show_design
from dssc_jax.core.errors import ConfigError
from dssc_jax.design import check
from dssc_jax.design.feasibility import limits
from dssc_jax.design.files import DesignFile
from dssc_jax.results.summary import jsonable


def require_one_form(as_json: bool, as_latex: bool) -> None:
    """Require that at most one of the formats JSON and LaTeX is requested.

    Raises:
        ConfigError: Both are requested.
    """
    if as_json and as_latex:
        raise ConfigError("--latex", "cannot be combined with --json: each is the only output on stdout")


def print_design(design: DesignFile, as_json: bool, as_latex: bool) -> int:
    """Print a design with its certificate, and return the exit code.

    Args:
        design: The design.
        as_json: Whether to print JSON.
        as_latex: Whether to print LaTeX.

    Returns:
        :data:`DONE` if the design is certified, else :data:`FAILS`.
    """
    certificate = check(design.parameters, design.bounds)
    reach = limits(design.parameters, design.bounds) if certificate.certified else None
    if as_json:
        modulation = None
        if design.modulation:
            needed_rho = design.modulation.needed_rho(certificate.practice)
            modulation = {"needed_rho": needed_rho, "first_sliding": design.modulation.first_sliding}
        content = {
            "design": design.name,
            "parameters": design.parameters._asdict(),
            "free": optional_table(design.free),
            "goal": optional_table(design.goal),
            "edges": design.edges,
            **certificate.to_dict(),
            "limits": optional_table(reach),
            "modulation": modulation,
        }
        print(json.dumps(jsonable(content), allow_nan=False))
    elif as_latex:
        print(latex(design, certificate))
    else:
        show_design(design, certificate, reach)
    return DONE if certificate.certified else FAILS


def optional_table(numbers: "NamedTuple | None") -> dict[str, object] | None:
    """The fields of a tuple by name; None if there is no tuple."""
    return None if numbers is None else numbers._asdict()
