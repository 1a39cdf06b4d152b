"""dssc-jax check: a design against Theorem 1."""

from dssc_jax.cli.declarations.designs import Check
from dssc_jax.cli.designing import print_design, require_one_form
from dssc_jax.design.files import load_design


def run(options: Check) -> int:
    """Check the design, print its certificate, and return whether it is certified as the exit code."""
    require_one_form(options.as_json, options.as_latex)
    return print_design(load_design(options.design), options.as_json, options.as_latex)
