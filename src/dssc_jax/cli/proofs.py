"""The command on proofs of the sampled loop: prove."""

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dssc_jax.cli import options as opt
from dssc_jax.cli.common import DONE, FAILS, app, attempt, load_study, parse_bounds, require_proofs
from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.proofs import BOXES, SWEEP_BOXES

if TYPE_CHECKING:
    from dssc_jax.proofs.prove import Proved
    from dssc_jax.study import Study

FOREIGN = "P0: the certificate is that of another loop than the folder's"


@app.command()
def prove(
    study: Annotated[
        str, typer.Argument(metavar="STUDY", help="A study; or the file of a certificate (.json), to verify it again.")
    ],
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE", help="Write the certificate (.json).")] = None,
    boxes: Annotated[
        int | None,
        typer.Option(
            "--boxes",
            metavar="N",
            min=1,
            help=f"Boxes of uncertain numbers [{BOXES}; {SWEEP_BOXES} with --over].",
        ),
    ] = None,
    over: Annotated[
        str | None, typer.Option("--over", metavar="NAME=LO:HI", help="Find the last value that is proved, from LO on.")
    ] = None,
    log: Annotated[bool, typer.Option("--log", help="Bisect --over on a logarithmic scale.")] = False,
    settings: opt.Set = None,
    as_json: opt.Json = False,
    allow_local: opt.Local = False,
) -> int:
    """Prove that the sampled loop slides and stays near its reference: exit 1 where it is not proved.

    The proof covers every value of k_p, a_p and mu within the support of their laws and every disturbance within its
    bounds, with sampling and lag. A verifier in exact ball arithmetic accepts it, or it does not count. A certificate's
    file is verified from the file alone. With --over, each value is proved on its own, from the safe end LO on, and the
    last one that is proved is told.
    """
    require_proofs()
    from dssc_jax.console.proofs import show_proof, show_verdict
    from dssc_jax.design.certification import NotCovered
    from dssc_jax.proofs.prove import check_certificate
    from dssc_jax.proofs.prove import prove as search
    from dssc_jax.proofs.verifier.verdict import ProofVerdict
    from dssc_jax.proofs.words import loop_in_words

    if study.endswith(".json"):
        content = read_json(Path(study))
        if isinstance(content, dict) and "certificates" in content:
            return check_sweep(content, Path(study).parent, as_json)
        verdict = check_certificate(content)
        if verdict.proved and is_foreign(content, Path(study)):
            verdict = ProofVerdict(False, FOREIGN, math.inf, math.inf)
        words = {} if verdict.reason.startswith("P0") else loop_in_words(content["problem"])
        if as_json:
            answer = verdict._asdict() if verdict.proved else {"proved": False, "reason": verdict.reason}
            print(json.dumps(answer | {"loop": words}, allow_nan=False))
        else:
            show_verdict(verdict, words)
        return DONE if verdict.proved else FAILS
    loaded = load_study(study, settings, None, None, allow_local).without_sweep()
    if over is not None:
        return prove_over(loaded, over, log, boxes or SWEEP_BOXES, out, as_json)
    try:
        proved = search(loaded, boxes=boxes or BOXES)
    except NotCovered as error:
        raise ConfigError(loaded.source, f"is outside of what a proof covers: {error}") from None
    write_certificate(proved, out)
    if as_json:
        print(json.dumps(proved.summary(), allow_nan=False))
    else:
        show_proof(proved.summary(), out)
    return DONE if proved.complete else FAILS


def is_foreign(content: dict[str, Any], path: Path) -> bool:
    """Whether a certificate lies in a tuning's folder, and is not that of the tuned loop."""
    from dssc_jax.analyses.loading import load
    from dssc_jax.analyses.tuning import Tuned
    from dssc_jax.analyses.tuning.result import PROOF_FILE
    from dssc_jax.study import Described

    if path.name != PROOF_FILE or not (path.parent / f"{Tuned.kind}.json").exists():
        return False
    tuned = load(path.parent)
    return (
        isinstance(tuned, Tuned) and not isinstance(tuned.study, Described) and tuned.proved_loop != content["problem"]
    )


def write_certificate(proved: "Proved", out: Path | None) -> None:
    """Write the certificate, if a file is given."""
    if out is not None:
        content = json.dumps(proved.certificate(), indent=1) + "\n"
        attempt(out, lambda: files.write_text(out, content))


def prove_over(study: "Study", over: str, log: bool, boxes: int, out: Path | None, as_json: bool) -> int:
    """Find the last value of a number that is proved; ``out`` gets its certificate."""
    from dssc_jax.console.terminal import output, progress_bar
    from dssc_jax.design.certification import NotCovered
    from dssc_jax.proofs.reach import proved_up_to

    name, bounds = parse_bounds(over)
    try:
        with progress_bar(study, quiet=as_json, of="values", compiles=False) as advance:
            reach = proved_up_to(study, name, bounds, log=log, boxes=boxes, progress=advance)
    except NotCovered as error:
        raise ConfigError(study.source, f"is outside of what a proof covers: {error}") from None
    if reach.last is not None:
        write_certificate(reach.last, out)
    if as_json:
        print(json.dumps(reach.summary(), allow_nan=False))
    else:
        output().print(reach.statement(), soft_wrap=True, markup=False)
    return FAILS if reach.last is None else DONE


def check_sweep(content: dict[str, Any], folder: Path, as_json: bool) -> int:
    """Verify the certificates of a sweep's points that are said to be proved.

    In a results folder, each must be a certificate of the folder's own loop at its point.
    """
    from dssc_jax.console.proofs import show_sweep_verdicts
    from dssc_jax.proofs.prove import check_certificate
    from dssc_jax.runs.prove_sweep import foreign_points

    try:
        pairs = zip(content["points"], content["certificates"], strict=True)
        said = [certificate for point, certificate in pairs if point["proved"]]
        study = study_of_folder(folder)
        foreign = [] if study is None else foreign_points(study, content["certificates"])
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError("proofs", f"are damaged: {error!r}") from None
    verdicts = [check_certificate(each) for each in said]
    reasons = [each.reason for each in verdicts if not each.proved]
    reasons += [f"P0: the certificate of point {i} is that of another loop than the folder's" for i in foreign]
    if as_json:
        counts = {"points": len(content["points"]), "certificates": len(said)}
        print(json.dumps({"proved": not reasons, **counts, "reasons": reasons}, allow_nan=False))
    else:
        show_sweep_verdicts(len(content["points"]), len(said), reasons)
    return FAILS if reasons else DONE


def study_of_folder(folder: Path) -> "Study | None":
    """The study of a results folder; None if it is none, or if its code is not loaded."""
    from dssc_jax.results.manifest import MANIFEST
    from dssc_jax.results.result import load_result
    from dssc_jax.study import Described

    if not (folder / MANIFEST).exists():
        return None
    study = load_result(folder).study
    return None if isinstance(study, Described) else study


def read_json(path: Path) -> Any:
    """The content of a file.

    Raises:
        ConfigError: it cannot be read, or it is no plain JSON.
    """
    from dssc_jax.proofs.certificate_text import certificate_content

    try:
        return certificate_content(files.read_text(path))
    except (OSError, ValueError) as error:
        raise ConfigError(str(path), f"cannot be read: {error}") from None
