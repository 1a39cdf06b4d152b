"""Section on the proofs of a sweep's points, beside the failures of their draws."""

import htpy as h
import numpy as np

import dssc_jax.plotting as plotting
from dssc_jax.plotting.standings import standing_of, standing_words
from dssc_jax.report.elements import Section, collapsible, count_text, figure, number, table
from dssc_jax.report.subject import Subject
from dssc_jax.report.vector import inline_svg
from dssc_jax.results.proofs import BOUNDS, SweepProofs
from dssc_jax.results.result import Result

CLAIM = (
    "A proof covers {covered} and every disturbance within its bounds, with sampling and lag. These are "
    "the folder's claims; dssc-jax prove FOLDER/proofs.json verifies every certificate again."
)


def proofs(subject: Subject) -> Section | None:
    """Section on the standing of the points and on the proved bounds; None without proofs."""
    result = subject.result
    if result.point_proofs is None or "proved" not in result.dataset:
        return None
    axes = list(result.study.axes)
    share = result.failed.mean("draw").transpose(*axes).values
    proved = result.dataset["proved"].transpose(*axes).values
    covered = result.point_proofs.claim.covered
    standings = standing_of(proved, share)
    counts = []
    for standing, text in enumerate(standing_words(covered)):
        counts.append((text, f"{np.count_nonzero(standings == standing):,}"))
    body: list[h.Node] = [
        table(count_text(proved.size, "point"), ("how a point stands", "points"), counts),
        h.p[CLAIM.format(covered=covered)],
    ]
    swept_axes = sum(size > 1 for size in proved.shape)
    if swept_axes == 2:
        text = f"{np.count_nonzero(proved)} of {proved.size} points are proved."
        body.append(figure(inline_svg(lambda: plotting.standing(result), text, "standing"), text))
    if proved.any():
        body += [largest_error_statement(result, result.point_proofs), bound_table(result, result.point_proofs)]
    return Section("proofs", "What is proved", body)


def largest_error_statement(result: Result, proofs: SweepProofs) -> h.Node:
    """The statement that is proved at the point with the largest proved bound of the error."""
    largest = int(np.nanargmax(proofs.error))
    index = np.unravel_index(largest, proofs.proved.shape)
    values = []
    for (name, axis), i in zip(result.study.axes.items(), index, strict=True):
        values.append(f"{name} = {number(axis[i])}")
    return h.p[f"The largest bound is proved at {', '.join(values)}: ", proofs.statements[largest]]


def bound_table(result: Result, proofs: SweepProofs) -> h.Node:
    """Table of the proved points with their bounds.

    The bounds are those that a vehicle never exceeds. If the proofs have none, it is the bound of |e| after settling.
    """
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
    for index in map(tuple, np.argwhere(proofs.proved)):
        row = [number(axis[i]) for axis, i in zip(axes.values(), index, strict=True)]
        row += [number(float(column[index])) for column in columns.values()]
        rows.append(row)
    caption = "Proved points: never exceeded" if proofs.bounds else "Proved points"
    return collapsible(f"All {count_text(len(rows), 'proved point')}", table(caption, (*axes, *heads), rows))
