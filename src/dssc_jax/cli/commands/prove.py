"""dssc-jax prove: prove a sampled loop with lag, or verify the certificates in a file."""

import json
from pathlib import Path

from dssc_jax.analyses.loading import load
from dssc_jax.analyses.tuning import Tuned
from dssc_jax.analyses.tuning.result import PROOF_FILE
from dssc_jax.cli.analysing import save_text
from dssc_jax.cli.declarations.designs import Prove
from dssc_jax.cli.exit_codes import DONE, FAILS
from dssc_jax.cli.loading import load_study, read_json
from dssc_jax.cli.parsing import parse_changes, parse_walk
from dssc_jax.cli.proving import proof_coverage
from dssc_jax.console.proofs import show_proof, show_sweep_verdicts, show_verdict
from dssc_jax.console.terminal import progress_bar, show_line
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.json_types import JsonObject
from dssc_jax.engine.integration import integration_error
from dssc_jax.proofs import BOXES, SWEEP_BOXES
from dssc_jax.proofs.claims import not_proved_text
from dssc_jax.proofs.prove import AnyProved, check_certificate, prove
from dssc_jax.proofs.prove_vehicle import VEHICLE_KIND
from dssc_jax.proofs.reach import proved_up_to
from dssc_jax.proofs.vehicle_words import stated_bounds, vehicle_in_words, vehicle_verdict_in_words
from dssc_jax.proofs.verifier.vehicle.verdict import VehicleVerdict
from dssc_jax.proofs.verifier.verdict import ProofVerdict
from dssc_jax.proofs.words import loop_in_words, verdict_in_words
from dssc_jax.results.manifest import MANIFEST
from dssc_jax.results.result import load_result
from dssc_jax.runs.prove_sweep import foreign_points
from dssc_jax.study import Described, Study

MALFORMED = ("P0", "V0")
"""How the reason of a verdict begins if the certificate's ``problem`` may be malformed."""
FOREIGN = "P0: the certificate is that of another loop than the folder's"
"""Reason of a verdict on a valid certificate that lies in the folder of another loop."""


def run(options: Prove) -> int:
    """Prove the study's loop, or verify a file of certificates."""
    if options.study.endswith(".json"):
        path = Path(options.study)
        content = read_json(path)
        if isinstance(content, dict) and "certificates" in content:
            return verify_sweep(content, path.parent, options.as_json)
        return verify_certificate(content, path, options.as_json)
    study = load_study(
        options.study, parse_changes(options.settings), options.allow_local, options.allow_native
    ).without_sweep()
    if options.over is not None:
        return prove_over(study, options.over, options)
    with proof_coverage(study):
        proved = prove(study, boxes=options.boxes or BOXES)
    write_certificate(proved, options.out)
    integration = None if options.no_check else integration_error(study)
    if options.as_json:
        check = integration.to_dict() if integration else None
        print(json.dumps(proved.summary() | {"integration": check}, allow_nan=False))
    else:
        simulated = f"simulations of this loop: {integration.text}" if integration else ""
        show_proof(proved.summary(), options.out, [not_proved_text(study), simulated])
    return DONE if proved.complete else FAILS


def verify_certificate(content: object, path: Path, as_json: bool) -> int:
    """Verify a certificate and print the verdict, with a description of its loop.

    Args:
        content: Content of the certificate's file.
        path: The file.
        as_json: Whether to print JSON.

    Returns:
        The exit code: :data:`DONE` if the verifier accepts the certificate.
    """
    verdict = check_certificate(content)
    words = {}
    if isinstance(content, dict) and not verdict.reason.startswith(MALFORMED):
        problem = content["problem"]
        if verdict.proved and is_of_another_loop(problem, path):
            verdict = verdict._replace(proved=False, reason=FOREIGN)
        else:
            words = vehicle_in_words(problem) if content.get("kind") == VEHICLE_KIND else loop_in_words(problem)
    if as_json:
        print(json.dumps(verdict_content(verdict) | {"loop": words}, allow_nan=False))
    elif isinstance(verdict, VehicleVerdict):
        show_verdict(vehicle_verdict_in_words(verdict), words)
    else:
        show_verdict(verdict_in_words(verdict), words)
    return DONE if verdict.proved else FAILS


def verdict_content(verdict: ProofVerdict | VehicleVerdict) -> JsonObject:
    """Return a verdict as JSON: whether the loop is proved, the reason if not, and otherwise the bounds."""
    if not verdict.proved:
        return {"proved": False, "reason": verdict.reason}
    if isinstance(verdict, VehicleVerdict):
        errors = {"error": verdict.settled["x"]["e"], "largest_error": verdict.bounds["x"]["e"]}
        return {"proved": True, "reason": "", **errors, **stated_bounds(verdict)}
    return verdict._asdict()


def is_of_another_loop(problem: JsonObject, path: Path) -> bool:
    """Whether a certificate lies in the folder of a tuning, but is not about the tuned loop.

    Args:
        problem: The certificate's description of its loop.
        path: File of the certificate.
    """
    if path.name != PROOF_FILE or not (path.parent / f"{Tuned.kind}.json").exists():
        return False
    tuned = load(path.parent)
    if not isinstance(tuned, Tuned) or isinstance(tuned.study, Described):
        return False
    return tuned.proved_loop != problem


def write_certificate(proved: AnyProved, out: Path | None) -> None:
    """Write the certificate of a proof, if the user names a file."""
    if out is not None:
        save_text(out, json.dumps(proved.certificate(), indent=1) + "\n")


def prove_over(study: Study, over: str, options: Prove) -> int:
    """Find the last value of a number for which the loop is proved, write its certificate and print the value.

    Args:
        study: The study, without a sweep.
        over: Text of the option ``--over``: the number and the ends of its walk.
        options: Options of the command.

    Returns:
        The exit code: :data:`FAILS` if nothing is proved.
    """
    walk = parse_walk(over)
    boxes = options.boxes or SWEEP_BOXES
    with proof_coverage(study), progress_bar(study, quiet=options.as_json, unit="values", compiles=False) as advance:
        reach = proved_up_to(study, walk.name, walk.bounds, log=options.log, boxes=boxes, progress=advance)
    if reach.last is not None:
        write_certificate(reach.last, options.out)
    if options.as_json:
        print(json.dumps(reach.summary(), allow_nan=False))
    else:
        show_line(reach.statement())
    return FAILS if reach.last is None else DONE


def verify_sweep(content: JsonObject, folder: Path, as_json: bool) -> int:
    """Verify the certificates of all points of a sweep that its file reports as proved.

    In a results folder, each certificate must be that of the folder's loop at its point.

    Args:
        content: Content of the file with the proofs.
        folder: Folder of the file.
        as_json: Whether to print JSON.

    Returns:
        The exit code: :data:`DONE` if all certificates are valid.

    Raises:
        ConfigError: The file or the result in its folder is damaged.
    """
    try:
        pairs = zip(content["points"], content["certificates"], strict=True)
        certificates = [certificate for point, certificate in pairs if point["proved"]]
        study = study_of_folder(folder)
        foreign = [] if study is None else foreign_points(study, content["certificates"])
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError("proofs", f"are damaged: {error!r}") from None
    reasons = []
    for certificate in certificates:
        verdict = check_certificate(certificate)
        if not verdict.proved:
            reasons.append(verdict.reason)
    reasons += [f"P0: the certificate of point {i} is that of another loop than the folder's" for i in foreign]
    if as_json:
        counts = {"points": len(content["points"]), "certificates": len(certificates)}
        print(json.dumps({"proved": not reasons, **counts, "reasons": reasons}, allow_nan=False))
    else:
        show_sweep_verdicts(len(content["points"]), len(certificates), reasons)
    return FAILS if reasons else DONE


def study_of_folder(folder: Path) -> Study | None:
    """Load the study of a results folder; None if the folder holds no result, or the study's code is not loaded."""
    if not (folder / MANIFEST).exists():
        return None
    study = load_result(folder).study
    return None if isinstance(study, Described) else study
