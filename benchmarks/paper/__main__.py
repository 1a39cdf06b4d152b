"""Run every experiment of the page; write its figures and the page."""

import time

from matplotlib import rc_context

import dssc_jax as dj
from benchmarks.paper import figures, monte_carlo, search, uncertain
from benchmarks.paper.claims import Claim, advantage, alike, before_disturbance, efforts, functions_rise, oscillation
from benchmarks.paper.cycles import cycles
from benchmarks.paper.loops import CASE_1, ROOT, Runs, field, four, load, simplified, two
from benchmarks.paper.page import Findings, page
from dssc_jax import plotting

FLIGHTS = 4  # winds of the field test


def comparisons() -> dict[str, Runs]:
    """The comparison's runs, by set-up."""
    return {
        "printed": four(),
        "Case 1's kappa_m": four(**{"controller.functions.kappa_m": CASE_1}),
        "kappa2 = 1": two(1.0),
        "kappa2 = 0.5": two(0.5),
        "both small": two(0.5, **{"controller.functions.delta_o": 0.0025}),
    }


def field_claims() -> tuple[Runs, list[Claim]]:
    """The first flight of the field test's set-up, and the claims over several winds."""
    plain, kept, low = (
        [field(draw, **changes) for draw in range(FLIGHTS)]
        for changes in ({}, {"predictor_term": True}, {"height": 0.0})
    )
    return plain[0], [
        efforts(plain, "u_n without 1/tau_m"),
        efforts(kept, "u_n of DSSC with 1/tau_m"),
        efforts(low, "without 1/tau_m, start 5 m below the path"),
    ]


def main() -> None:
    began = time.perf_counter()
    full, simple = dj.simulate(load("paper_case1")), simplified(80.0)
    settings = comparisons()
    flight, of_field = field_claims()
    claims = [
        *before_disturbance(full, simple),
        functions_rise(full, simple),
        *oscillation(settings["printed"]),
        *advantage(settings["printed"], "kappa_m = kappa1/kappa2"),
        *advantage(settings["Case 1's kappa_m"], "kappa_m of Case 1"),
        alike(settings["kappa2 = 1"], 1.0),
        alike(settings["kappa2 = 0.5"], 0.5),
        alike(settings["both small"], 0.5, ", and delta = 0.0025 in k_o too"),
        *of_field,
    ]
    values, flights = monte_carlo.experiment()
    sweep, answer = uncertain.robustness()
    with rc_context(plotting.STYLE):
        figures.save(figures.draw_figure_3(full, simple), "fig3")
        figures.save(figures.draw_figure_4(full, simple), "fig4")
        figures.save(figures.draw_figure_5(settings["printed"], settings["Case 1's kappa_m"]), "fig5")
        figures.save(figures.draw_figure_6(flight), "fig6_fig7")
        figures.save(figures.draw_efforts(flight), "field_efforts")
        dssc, other = flights["", "DSSC"], flights["", "STA clipped"]
        figures.save(figures.draw_monte_carlo(values, dssc, other), "monte_carlo")
    figures.save(plotting.sweep(sweep), "robustness")
    found = Findings(claims, settings, cycles(), search.rows(), values, flights, answer, uncertain.noise_offset())
    text = page(found, time.perf_counter() - began)
    (ROOT / "docs" / "paper.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
