"""Figure of a failure probability from strata: probability, draws and failures of each stratum."""

import numpy as np
from matplotlib.figure import Figure

from dssc_jax.plotting.style import BLUE, GREY, RED, SLIDE, styled, title
from dssc_jax.results.analysis import Analysis
from dssc_jax.statistics import clopper_pearson


@styled
def strata(analysis: Analysis) -> Figure:
    """Plot the strata: probability and share of the draws on the left, share of failures on the right.

    Exact intervals belong to the shares of failures.

    Args:
        analysis: The return value of :func:`dssc_jax.probability`.
    """
    summary = analysis.summary()
    draws = np.array(summary["draws"])
    failures = np.array(summary["failures"])
    rows = np.arange(len(draws))
    figure = Figure(figsize=SLIDE, layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    left.barh(rows - 0.2, summary["weights"], height=0.4, color=GREY, label="probability of the stratum")
    left.barh(rows + 0.2, draws / draws.sum(), height=0.4, color=BLUE, label="share of the draws")
    left.set(xlabel="share", ylabel="stratum, by predicted slack", yticks=rows)
    left.legend()
    shares = failures / draws
    low, high = clopper_pearson(failures, draws).T
    right.errorbar(shares, rows, xerr=[shares - low, high - shares], fmt="o", color=RED, capsize=3)
    right.set(xlabel="share that fails, 95 % intervals", xlim=(-0.02, 1.02))
    required = "; ".join(summary["requirements"])
    title(figure, f"{summary['study']}: {required}\n{analysis.headline}")
    return figure
