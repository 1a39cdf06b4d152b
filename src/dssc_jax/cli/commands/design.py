"""dssc-jax design: gains with a certificate from bounds."""

from dssc_jax.cli.analysing import attempt
from dssc_jax.cli.declarations.designs import Design
from dssc_jax.cli.designing import print_design, require_one_form
from dssc_jax.core import files
from dssc_jax.design.files import design_toml, load_design


def run(options: Design) -> int:
    """Find the gains, write the design file if one is named, and print the certificate."""
    require_one_form(options.as_json, options.as_latex)
    design = load_design(options.bounds, complete=False)
    if options.out is not None:
        out = options.out
        attempt(out, lambda: files.write_text(out, design_toml(design)))
    return print_design(design, options.as_json, options.as_latex)
