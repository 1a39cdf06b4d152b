"""Section on proofs: what is proved at each point of a sweep, beside what its draws do."""

import htpy as h
import numpy as np

import dssc_jax.plotting as plotting
from dssc_jax.plotting.standings import standing_of, standing_words
from dssc_jax.report.elements import Section, count_text, figure, folded, number, table
from dssc_jax.report.subject import Subject
from dssc_jax.report.vector import inline
from dssc_jax.results.proofs import BOUNDS, SweepProofs
from dssc_jax.results.result import Result

CLAIM = (
    "A proof covers {covered} and every disturbance within its bounds, with sampling and lag. These are "
    "the folder's claims; dssc-jax prove FOLDER/proofs.json verifies every certificate again."
)


def proofs(subject: Subject) -> Section | None:
    """How the points stand, and the proved bounds; None without proofs."""
    result = subject.result
    if result.point_proofs is None or "proved" not in result.dataset:
        return None
    axes = list(result.study.axes)
    share = result.failed.mean("draw").transpose(*axes).values
    proved = result.dataset["proved"].transpose(*axes).values
    covered = result.point_proofs.claim.covered
    kinds = standing_of(proved, share)
    counts = [(text, f"{np.count_nonzero(kinds == kind):,}") for kind, text in enumerate(standing_words(covered))]
    body: list[h.Node] = [
        table(count_text(proved.size, "point"), ("how a point stands", "points"), counts),
        h.p[CLAIM.format(covered=covered)],
    ]
    if sum(size > 1 for size in proved.shape) == 2:
        text = f"{np.count_nonzero(proved)} of {proved.size} points are proved."
        body.append(figure(inline(lambda: plotting.standing(result), text, "standing"), text))
    if proved.any():
        body += [largest_statement(result, result.point_proofs), proved_points(result, result.point_proofs)]
    return Section("proofs", "What is proved", body)


def largest_statement(result: Result, proofs: SweepProofs) -> h.Node:
    """The proved statement, at the proved point with the largest bound of the error."""
    largest = int(np.nanargmax(proofs.error))
    place = np.unravel_index(largest, proofs.proved.shape)
    pairs = zip(result.study.axes.items(), place, strict=True)
    at = ", ".join(f"{name} = {number(values[i])}" for (name, values), i in pairs)
    return h.p[f"The largest bound is proved at {at}: ", proofs.statements[largest]]


def proved_points(result: Result, proofs: SweepProofs) -> h.Node:
    """The proved bounds of every proved point: of a vehicle all that it never exceeds, else of |e| once settled."""
    axes = result.study.axes
    columns = proofs.bounds
    units = {bound.label: bound.unit for bound in BOUNDS}
    heads = [f"{label} [{units[label]}]" for label in columns]
    if not columns:
        error = result.dataset["proved_error"]
        label = f"largest {proofs.claim.error} once settled, proved"
        columns = {label: proofs.error}
        heads = [f"{label} [{error.attrs['units']}]"]
    rows = []
    for at in np.argwhere(proofs.proved):
        place = tuple(at)
        values = [number(axis[i]) for axis, i in zip(axes.values(), place, strict=True)]
        rows.append((*values, *(number(float(column[place])) for column in columns.values())))
    caption = "Proved points: never exceeded" if proofs.bounds else "Proved points"
    return folded(f"All {count_text(len(rows), 'proved point')}", table(caption, (*axes, *heads), rows))
