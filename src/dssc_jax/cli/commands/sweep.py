"""dssc-jax sweep: every draw of a study at every point of its sweep."""

from pathlib import Path

from dssc_jax.cli.analysing import usual_folder, write_or_refuse
from dssc_jax.cli.declarations.simulation import Sweep
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.parsing import parse_sweep_axes
from dssc_jax.cli.proving import proof_coverage, require_proofs
from dssc_jax.cli.running import computed_result, print_result, simulated_study
from dssc_jax.console.terminal import progress_bar
from dssc_jax.core.errors import ConfigError
from dssc_jax.results.result import Result
from dssc_jax.study import Study


def run(options: Sweep) -> int:
    """Simulate the points, prove them if asked, and print the result."""
    study = simulated_study(options)
    if options.over:
        study = study.override({"sweep": parse_sweep_axes(options.over)})
    if not study.axes:
        raise ConfigError(study.source, "has no [sweep]; add one, or --over NAME=LO:HI:COUNT")
    if options.prove:
        require_provable(study)
    out = options.out or usual_folder(study, "sweep", options.over, options.settings, options.draws, options.seed)
    result = computed_result(study, out, options)
    if options.prove and not result.proofs:
        result = proved_sweep(result, out, options)
    print_result(result, out, options.as_json)
    return DONE


def require_provable(study: Study) -> None:
    """Require that the points of a study's sweep can be proved, before anything is simulated.

    Raises:
        ConfigError: A package is not installed, or proofs do not cover the first point.
    """
    require_proofs()
    from dssc_jax.proofs.coverage import problem_of  # both imports need optional packages
    from dssc_jax.runs.prove_sweep import sweep_points

    with proof_coverage(study):
        problem_of(next(sweep_points(study)))


def proved_sweep(result: Result, out: Path, options: Sweep) -> Result:
    """Prove the points of a sweep, write the proofs into its folder, and return the result with the proofs.

    Args:
        result: Result of the sweep.
        out: Its folder.
        options: Options of the command.

    Raises:
        ConfigError: The proofs cannot be written.
    """
    from dssc_jax.runs.prove_sweep import prove_sweep  # needs optional packages

    with progress_bar(result.study, quiet=options.as_json, unit="proofs", compiles=False) as advance:
        proofs = prove_sweep(result.study, boxes=options.boxes, progress=advance)
    write_or_refuse(out, lambda: proofs.save(out))
    return result.with_proofs(proofs)
