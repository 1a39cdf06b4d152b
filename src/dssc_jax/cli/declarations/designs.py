"""Options of the commands on certificates: check, design, prove."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from dssc_jax.cli.declarations.types import Json, Local, Native, NoCheck, Set
from dssc_jax.proofs import BOXES, SWEEP_BOXES

Latex = Annotated[bool, typer.Option("--latex", help="Print the tables as LaTeX (booktabs).")]


@dataclass(frozen=True, kw_only=True)
class Check:
    """Check a design against Theorem 1: exit 1 where it is not certified.

    Table 1's inequalities must hold strictly over the whole interval of k_p, and phi_b must meet the small-gain
    condition. Tells each slack, the guaranteed residual and decay rate, and the sampling period that the design needs.
    """

    design: Annotated[
        Path, typer.Argument(metavar="DESIGN", help="A design file: [bounds] with [parameters], [free] or [goal].")
    ]
    as_json: Json = False
    as_latex: Latex = False


@dataclass(frozen=True, kw_only=True)
class Design:
    """Find gains with a certificate from bounds; or first gains for the plant of a study.

    Of a study, its plant, its linear actuators, what it measures and T_s matter: the gains of PID, LQG, state feedback
    or SSC follow from the bandwidth, in the plant's units, and the sampled loop with them is stable. --out writes the
    study with them; `loop` gives their margins. Of bounds, [free] fixes free parameters of Table 1; what it leaves open
    is chosen for the [goal]: without one, for the smallest guaranteed error at a sampling period of 1 ms.
    """

    bounds: Annotated[
        Path, typer.Argument(metavar="BOUNDS|STUDY", help="A file with [bounds]; [free], [goal] as wanted. Or a study.")
    ]
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE", help="Write the design file, or the study.")] = (
        None
    )
    controller: Annotated[
        str | None,
        typer.Option("--controller", metavar="KIND", help="Of a study: pid, lqg, state_feedback or ssc [pid]."),
    ] = None
    bandwidth: Annotated[
        float | None,
        typer.Option(
            "--bandwidth", metavar="RAD/S", help="Of a study: where the loop gain crosses 1 [0.05 pi/T_s or less]."
        ),
    ] = None
    limit: Annotated[
        float | None, typer.Option("--limit", metavar="U", help="Of a study: largest command, in its unit.")
    ] = None
    at: Annotated[
        float | None,
        typer.Option("--at", metavar="Y", help="Of a nonlinear plant: output at which it rests, not its start."),
    ] = None
    allow_local: Local = False
    allow_native: Native = False
    as_json: Json = False
    as_latex: Latex = False


@dataclass(frozen=True, kw_only=True)
class Prove:
    """Prove that the sampled loop slides and stays near its reference: exit 1 where it is not proved.

    The proof covers every value of k_p, a_p and mu within the support of their laws and every disturbance within its
    bounds, with sampling and lag. For a vehicle that hovers, it covers every wind within its bounds, and every vehicle
    within the support of the laws. A verifier in exact ball arithmetic accepts it, or it does not count. A
    certificate's file is verified from the file alone. The proved loop moves continuously; some draws, simulated with
    twice the substeps, tell how far the simulated loop is from it. With --over, each value is proved on its own, from
    the safe end LO on, and the last one that is proved is told.
    """

    study: Annotated[
        str, typer.Argument(metavar="STUDY", help="A study; or the file of a certificate (.json), to verify it again.")
    ]
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE", help="Write the certificate (.json).")] = None
    boxes: Annotated[
        int | None,
        typer.Option(
            "--boxes", metavar="N", min=1, help=f"Boxes of uncertain numbers [{BOXES}; {SWEEP_BOXES} with --over]."
        ),
    ] = None
    over: Annotated[
        str | None, typer.Option("--over", metavar="NAME=LO:HI", help="Find the last value that is proved, from LO on.")
    ] = None
    log: Annotated[bool, typer.Option("--log", help="Bisect --over on a logarithmic scale.")] = False
    no_check: NoCheck = False
    settings: Set = None
    as_json: Json = False
    allow_local: Local = False
    allow_native: Native = False
