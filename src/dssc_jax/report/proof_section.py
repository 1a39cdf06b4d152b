"""Section on proofs: what is proved at each point of a sweep, beside what its draws do."""

import htpy as h
import numpy as np

import dssc_jax.plotting as plotting
from dssc_jax.plotting.standings import STANDINGS, standing_of
from dssc_jax.report.elements import Section, counted, figure, folded, number, table
from dssc_jax.report.subject import Subject
from dssc_jax.report.vector import inline

CLAIM = (
    "A proof covers every plant of the laws and every disturbance within its bounds, with sampling and lag. These are "
    "the folder's claims; dssc-jax prove FOLDER/proofs.json verifies every certificate again."
)


def proofs(subject: Subject) -> Section | None:
    """How the points stand, and the proved bounds of |e|; None without proofs."""
    result = subject.result
    if "proved" not in result.dataset:
        return None
    axes = list(result.study.axes)
    share = result.failed.mean("draw").transpose(*axes).values
    proved = result.dataset["proved"].transpose(*axes).values
    error = result.dataset["proved_error"].transpose(*axes).values
    kinds = standing_of(proved, share)
    counts = [(text, f"{np.count_nonzero(kinds == kind):,}") for kind, (_, text) in enumerate(STANDINGS)]
    body: list[h.Node] = [table(counted(proved.size, "point"), ("how a point stands", "points"), counts), h.p[CLAIM]]
    if sum(size > 1 for size in proved.shape) == 2:
        text = f"{np.count_nonzero(proved)} of {proved.size} points are proved."
        body.append(figure(inline(lambda: plotting.standing(result), text, "standing"), text))
    rows = []
    for at in np.ndindex(proved.shape):
        if proved[at]:
            values = [number(result.study.axes[name][i]) for name, i in zip(axes, at, strict=True)]
            rows.append((*values, number(float(error[at]))))
    if rows:
        unit = result.dataset["proved_error"].attrs["units"]
        listed = table("Proved points", (*axes, f"largest |e| once settled, proved [{unit}]"), rows)
        body.append(folded(f"All {counted(len(rows), 'proved point')}", listed))
    return Section("proofs", "What is proved", body)
