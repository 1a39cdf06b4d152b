"""``make proofs``: the map, random designs, adversarial simulations and falsified certificates.

``python -m benchmarks.proofs PART ..`` measures some of them.
"""

import copy
import itertools
import sys
import tempfile
import time
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import dssc_jax as dj
from benchmarks.page import put
from benchmarks.proofs.designs import (
    DesignProof,
    at_origin,
    design_proofs,
    exact_worst,
    local_margin,
    proved_shares,
)
from benchmarks.proofs.flights import adversarial
from dssc_jax import plotting
from dssc_jax.design import guarantee
from dssc_jax.design.loop_bounds import design_of
from dssc_jax.proofs import SWEEP_BOXES
from dssc_jax.proofs.coverage import problem_of
from dssc_jax.proofs.verifier.verdict import verify_certificate
from dssc_jax.results.proofs import SweepProofs
from dssc_jax.runs.prove_sweep import prove_sweep, sweep_points

ROOT = Path(__file__).parents[2]
STUDY = ROOT / "studies" / "design_map.toml"
MARGIN = ROOT / "studies" / "certified_margin.toml"
CASE2 = ROOT / "studies" / "paper_case2.toml"
TUNED = ROOT / "studies" / "tune_proved.toml"
DESIGNS, FLIGHTS, FALSIFIED, CHECKS = 100, 1000, 300, 200
MOST_BOXES = 64  # at each value of a lag
LAGS = (0.001, 0.003, 0.01, 0.013)  # s, of certified_margin
SECONDS, UNSTABLE = 20.0, 1000.0  # of a simulation; variation of a command that oscillates [m/s]
ROUNDED = 1.0 + 1e-9


@cache
def proved_map() -> SweepProofs:
    """The map's proofs."""
    return prove_sweep(dj.Study.load(STUDY), boxes=1)


def map_text() -> str:
    """What the map shows; its figure is the README's."""
    with tempfile.TemporaryDirectory() as folder:
        result = dj.run(dj.Study.load(STUDY), Path(folder) / "map")
    proofs = proved_map()
    result = result.with_proofs(proofs)
    plotting.save_figure(plotting.sweep(result), ROOT / "docs" / "figures", "design_map")
    variation = result.dataset["command_tv_after_20"].max("draw").values
    stable, proved = variation < UNSTABLE, proofs.proved
    theorem = result.with_theorem().dataset["certified"].values.astype(bool)
    failing = result.failed.mean("draw").values
    ratio = (proofs.error / result.dataset["error_max_after_20"].max("draw").values)[proved]
    each = [point["seconds"] for point, here in zip(proofs.points, proved.ravel(), strict=True) if here]
    draws, certified = result.failed.sizes["draw"], int(theorem.sum())
    return (
        f"`dssc-jax sweep design_map --prove --boxes 1`: {proved.size} points, {draws} draws at each. "
        f"{int(proved.sum())} points are proved, {int((proved & stable).sum())} of the {int(stable.sum())} without an "
        f"unstable draw; "
        f"{int((proved & (failing > 0)).sum())} of them have a draw that fails. Theorem 1, which knows neither lag nor "
        f"sampling, certifies {certified}; in {int((theorem & (failing == 1.0)).sum())} of these every draw fails. The "
        f"proved bound of |e| is {np.median(ratio):.2g} times the largest seen in the draws (median; at most "
        f"{ratio.max():.2g}), for all plants and disturbances. A proved point took {np.median(each):.2g} s "
        f"(median), the map {proofs.seconds:.0f} s."
    )


def designs_text(designs: list[DesignProof]) -> str:
    """What random designs show."""
    good = [each for each in designs if not each.reason]
    ratios = np.array([each.proved / each.exact for each in good])
    theorem = np.median([each.theorem / each.exact for each in good])
    return (
        f"{len(designs)} random strict designs (those of [conservatism](conservatism.md)), T_s a third of the proposed "
        f"one, with a lag of order 2 at half of the loop's local margin: {len(good)} are proved. The proved bound of "
        f"|e| over the exact worst case of the loop linearised at the origin (the l1 norm): median "
        f"{np.median(ratios):.4f}, largest {ratios.max():.4f}. Theorem 1's bound, without the lag: "
        f"median {theorem:.3g}."
    )


def flights_text() -> str:
    """Adversarial simulations of every proved point."""
    study, proofs = dj.Study.load(STUDY), proved_map()
    flown = left = 0
    closest = 0.0
    for seed, (point, summary) in enumerate(zip(sweep_points(study), proofs.points, strict=True)):
        if not summary["proved"]:
            continue
        result = adversarial(point, FLIGHTS, SECONDS, seed)
        outside = ~(result.largest <= ROUNDED * summary["largest_error"]) | ~(result.sliding >= 0.0)
        left += int(outside.sum())
        flown += FLIGHTS
        closest = max(closest, float(result.largest.max() / summary["largest_error"]))
    return (
        f"{flown:,} adversarial simulations of the proved points (plants at the corners or within, triangles of the "
        f"steepest slope, the worst input of the linear loop): {left} leave the proved bound of |e| or stop sliding; "
        f"the nearest reaches {closest:.3f} of the bound."
    )


def falsified(certificate: dict[str, Any], rng: np.random.Generator) -> tuple[str, dict[str, Any]]:
    """A certificate with one thing changed."""
    content = copy.deepcopy(certificate)
    problem, stage = content["problem"], content["proofs"][0]["stages"][0]
    kind = str(rng.choice(["P", "mu", "T_s", "slope", "level", "region", "sign", "bounds", "start", "box"]))
    up = float(rng.choice([0.99, 1.01]))
    match kind:
        case "P":
            p = np.array(stage["p"])
            stage["p"] = (p * (1.0 + 0.01 * rng.standard_normal(p.shape))).tolist()
        case "mu":
            problem["mu"] = [up * each for each in problem["mu"]]
            rate = [1.0 / problem["mu"][1], 1.0 / problem["mu"][0]]
            content["proofs"][0]["box"]["rate"] = rate
        case "T_s":
            problem["sample_time"] *= up
        case "slope" | "level":
            problem[kind] *= up
        case "region":
            stage["sigma"], stage["e"] = 1.1 * stage["sigma"], 1.1 * stage["e"]
        case "sign":
            stage["p"] = (-np.array(stage["p"])).tolist()
        case "bounds":
            name = "bounds" if "bounds" in stage else "multipliers"
            stage[name] = [0.9 * each for each in stage[name]]
        case "start":
            problem["initial"] = [[1.05 * each for each in pair] for pair in problem["initial"]]
        case _:
            box = content["proofs"][0]["box"]
            box["k_p"] = [box["k_p"][0], 0.99 * box["k_p"][1]]
    return kind, content


def falsified_text() -> str:
    """How falsified certificates fare; those that are accepted are simulated."""
    study, proofs = dj.Study.load(STUDY), proved_map()
    rng = np.random.default_rng(11)
    proved = [i for i, point in enumerate(proofs.points) if point["proved"]]
    points, rejected, silent, wrong, closest = list(sweep_points(study)), 0, 0, 0, 0.0
    accepted: dict[str, int] = {}
    for index in itertools.islice(itertools.cycle(proved), FALSIFIED):
        kind, content = falsified(proofs.certificates[index], rng)
        verdict = verify_certificate(content)
        if not verdict.proved:
            rejected += 1
            silent += not verdict.reason
            continue
        accepted[kind] = accepted.get(kind, 0) + 1
        problem = content["problem"]
        changes = {"loop.sample_time": problem["sample_time"], "unmodelled.mu": problem["mu"][0]}
        changes |= {"plant.initial": [pair[0] for pair in problem["initial"]], "requirement": []}
        changes |= {"disturbance.amplitude": problem["level"], "loop.duration": 5000 * problem["sample_time"]}
        changes |= {"disturbance.period": 2.0 * np.pi * problem["level"] / problem["slope"], "metrics": {"after": 0.0}}
        result = adversarial(points[index].override(changes), CHECKS, 4.0, index)
        closest = max(closest, float(result.largest.max() / verdict.largest_error))
        wrong += int((result.largest > ROUNDED * verdict.largest_error).any() or (result.sliding < 0.0).any())
    kinds = ", ".join(f"{name} {count}" for name, count in sorted(accepted.items()))
    return (
        f"{FALSIFIED} certificates with one thing changed (P, mu, T_s or a bound by 1 %, region, signs, start, box): "
        f"{rejected} are rejected, {silent} of them without a reason; {sum(accepted.values())} are accepted, since "
        f"their slack covers the change ({kinds}). {CHECKS} adversarial simulations of each: {wrong} are "
        f"false; the nearest reaches {closest:.3f} of its bound."
    )


def margins_text() -> str:
    """How far along the lag random designs are proved, in Theorem 1's residual set."""
    shares = np.array(proved_shares(DESIGNS))
    return (
        f"{DESIGNS} random strict designs, at the four corners of their k_p and a_p: the largest lag of order 2 at "
        "which the verifier accepts a V for all gains of Theorem 1's residual set, over the corners' local margin: "
        f"median {np.median(shares):.3g}, smallest {shares.min():.3g} (tried at most: 0.99)."
    )


def laws_text() -> str:
    """Three uncertain numbers at once, and how far along the lag all k_p and a_p of the laws are proved."""
    study = dj.Study.load(MARGIN)
    whole, problem = dj.prove(study), problem_of(study)
    plants = itertools.product(problem.k_p, problem.a_p)
    local = min(local_margin(replace(problem, k_p=(k, k), a_p=(a, a))) for k, a in plants)
    reaches, times = {}, {}
    for boxes in (SWEEP_BOXES, MOST_BOXES):
        began = time.perf_counter()
        reaches[boxes] = dj.proved_up_to(study, "unmodelled.mu", (0.5 * local, local), boxes=boxes).proved / local
        times[boxes] = time.perf_counter() - began
    reached = " and ".join(
        f"{share:.3g} of it with {boxes} boxes at each value ({times[boxes]:.0f} s)" for boxes, share in reaches.items()
    )
    return (
        f"`certified_margin`, whose laws are those of k_p, a_p and mu: {'proved' if whole.complete else 'not proved'} "
        f"in {len(whole.proofs)} boxes, {whole.seconds:.0f} s. With all its k_p and a_p, from its own start, the "
        f"smallest local margin of the four corners is {local:.4g} s; mu is proved up to {reached}."
    )


def case2_text() -> str:
    """How far along the lag the gains of Case 2 are proved from 40 m."""
    changes: dict[str, Any] = {"controller.predictor_start": "matched", "disturbance": {"kind": "none"}}
    changes |= {"reference": {"kind": "zero"}, "unmodelled": {"kind": "lag", "order": 2, "mu": 0.01}, "requirement": []}
    base = dj.Study.load(CASE2).override(changes)
    parts = []
    for form in ("conservative", "implicit"):
        study = base.override({"controller.discretisation": form})
        local = local_margin(problem_of(study))
        reach = dj.proved_up_to(study, "unmodelled.mu", (1e-3, local), log=True, boxes=1)
        parts.append(f"{form} form {reach.proved:.3g} s, local margin {local:.3g} s ({reach.reason} beyond)")
    return (
        "Case 2's own gains (square-root functions, T_s = 5 ms, rho = 1.5 m/s), x from 40 m, matched start, no "
        f"disturbance, proved up to a lag of order 2 with mu: {'; '.join(parts)}."
    )


def tuning_text() -> str:
    """The largest proved lag and the least proved bound of |e|, tuned from the same start."""
    study = dj.Study.load(TUNED)
    parts = []
    for change in ({}, {"tune.over": {}, "tune.aim": "proved_error"}):
        tuned = dj.tune(study.override(change))
        aimed = tuned.facts.aimed
        assert aimed is not None
        moves = tuned.values.items()
        gains = ", ".join(f"{name.split('.')[-1]} {tuned.start[name]:.3g} -> {value:.3g}" for name, value in moves)
        bounds = ", ".join(f"{name} {b:.4g} -> {c:.4g}" for name, (_, b, c) in tuned.verdict.limits.items())
        parts.append(
            f"* `{aimed.aim}`: {aimed.start:.4g} -> {aimed.result:.4g} by {gains}; on {tuned.verdict.draws} "
            f"fresh draws mean {bounds}; {tuned.facts.stopped}; {tuned.facts.seconds:.0f} s."
        )
    table = study.config.tune
    assert table is not None
    return (
        f"`tune_proved`, {table.steps} evaluations at most, from gains that Theorem 1 certifies. On the draws, neither "
        "the error nor the variation of the command may get worse. The last proved mu [s], and the proved bound of "
        "abs(e) [m] at mu = 5 ms:\n\n" + "\n".join(parts)
    )


def conservatism_text() -> str:
    """Bounds of |e| of one loop by Theorem 1, proved, simulated and exact, for several lags."""
    base = dj.Study.load(MARGIN).override({"plant.k_p": 1.0, "plant.a_p": 0.3, "requirement": [], "draws": 1})
    p, bounds = design_of(base)
    theorem = float(guarantee(p, bounds).e)
    head = "| mu [s] | Theorem 1, without lag and sampling | proved | largest simulated | worst case, linearised |"
    rows = [head, "|---|---|---|---|---|"]
    for mu in LAGS:
        study = base.override({"unmodelled.mu": mu})
        proved, exact = dj.prove(study), exact_worst(at_origin(problem_of(study)))
        at_rest = study.override({"plant.initial": [0.0, 0.0]})
        flown = float(adversarial(at_rest, CHECKS, SECONDS, 1).largest.max())
        rows.append(f"| {mu:g} | {theorem:.3g} | {proved.error:.4g} | {flown:.4g} | {exact:.4g} |")
    return (
        "Bounds of abs(e) [m] once settled: `certified_margin` with k_p = 1, a_p = 0.3, T_s = 0.5 ms and disturbances "
        f"of slope 0.105 m/s^2. Simulated: the largest of {CHECKS} hard disturbances from rest, which need not include "
        "the worst one. Linearised: the l1 norm, which is the exact worst case of the loop linearised at sigma = e = 0."
        "\n\n" + "\n".join(rows)
    )


def main() -> None:
    """Measure the parts that are named, or all, and write each into the page."""
    parts = {
        "map": map_text,
        "designs": lambda: designs_text(design_proofs(DESIGNS)),
        "margins": margins_text,
        "laws": laws_text,
        "case 2": case2_text,
        "flights": flights_text,
        "falsified": falsified_text,
        "tuning": tuning_text,
        "proved": conservatism_text,
    }
    for name in sys.argv[1:] or parts:
        began = time.perf_counter()
        text = parts[name]()
        page = "conservatism.md" if name == "proved" else "proofs.md"
        put(name, f"{text}\n\n({time.perf_counter() - began:.0f} s.)", ROOT / "docs" / page)


if __name__ == "__main__":
    main()
