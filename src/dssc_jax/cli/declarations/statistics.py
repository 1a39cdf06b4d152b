"""Options of the commands for statistics: plan, sensitivity, laws, probability, rare."""

from dataclasses import dataclass
from typing import Annotated

import typer

from dssc_jax.analyses.defaults import (
    FEWER_PLAIN,
    LEAST_REPEATS,
    LIMIT,
    MOST_STRATIFIED,
    MOVES,
    PARTICLES,
    PLAIN,
    REPEATS,
    VARIATION,
    WIDTH,
)
from dssc_jax.cli.declarations.types import (
    DrawsOptions,
    Json,
    OutputOptions,
    RareMethod,
    SeededOptions,
    StatedOptions,
    TrustCode,
)


@dataclass(frozen=True, kw_only=True)
class Plan:
    """How many draws does my question need?

    Prints the numbers of draws for a failure probability (by Chernoff's bound; by the exact interval, at the expected
    count and in nearly all runs), for the worst case, for no failure at all, and for tolerance limits (Wilks).
    """

    error: Annotated[
        float, typer.Option("--error", metavar="E", help="Accuracy of a probability, or share beyond a limit.")
    ] = 0.05
    confidence: Annotated[float, typer.Option("--confidence", metavar="C", help="Confidence of every statement.")] = (
        0.95
    )
    probability: Annotated[
        float | None, typer.Option("--probability", metavar="P", help="Failure probability that you expect.")
    ] = None
    as_json: Json = False


@dataclass(frozen=True, kw_only=True)
class Sensitivity(OutputOptions, DrawsOptions):
    """Which uncertain numbers matter, for each metric and for failure?

    sobol: first-order and total indices; shapley: the variance shared out among numbers that may be correlated. The
    draws, rounded down to a power of two, are the rows of a sample that is simulated about once for each number. If
    failures are too rare, the answer is the number of rows that they need. morris: a screening of many numbers; the
    draws are the total number of simulations. All with intervals. The study's [sweep] is ignored.
    """

    method: Annotated[
        str, typer.Option("--method", metavar="NAME", help="sobol, shapley (numbers may be correlated) or morris.")
    ] = "sobol"


@dataclass(frozen=True, kw_only=True)
class Laws(OutputOptions, StatedOptions, DrawsOptions):
    """How wrong may the laws be before too many draws fail?

    How far the true laws may lie from the assumed ones before the failure probability can exceed the limit: in total
    variation, Kullback-Leibler and chi-square divergence; as a shift of all means and a widening of all laws in the
    worst direction; and one law at a time. Each number holds with 95 % confidence. Shifts and widenings use the
    weights of the same draws; where these are too uneven, --fresh simulates new draws.

    A result is analysed as it is stored; a study is simulated first, and its [sweep] is ignored.

    Where the arguments of laws are ranges, { normal = [[0.9, 1.1], 0.1] }, the answer is the interval of the failure
    probability over all laws within them. As a check, --fresh N simulates N new draws under both the best and the
    worst law.
    """

    study: Annotated[str, typer.Argument(metavar="STUDY|RESULT", help="A study, or the folder of a run.")]
    limit: Annotated[float, typer.Option("--limit", metavar="P", help="Largest failure probability allowed.")] = LIMIT
    fresh: Annotated[int, typer.Option("--fresh", metavar="N", help="New draws to simulate under changed laws.")] = 0
    trust_code: TrustCode = False


@dataclass(frozen=True, kw_only=True)
class Probability(OutputOptions, SeededOptions):
    """A failure probability to a width, by as few simulations as a prediction allows.

    A pilot of plain draws predicts where draws fail. The numbers are divided into strata along the predicted border of
    failure, and draws are spent where the prediction is in doubt. The interval holds however bad the prediction is. The
    output tells how many plain draws an interval as narrow would take. The study's [sweep], draws and sampling are
    ignored. For probabilities below some 1e-3, ask rare.
    """

    width: Annotated[float, typer.Option("--width", metavar="W", help="Width of the interval to aim at.")] = WIDTH
    most: Annotated[int, typer.Option("--most", metavar="N", help="Largest number of draws in the strata.")] = (
        MOST_STRATIFIED
    )


@dataclass(frozen=True, kw_only=True)
class Rare(OutputOptions, SeededOptions):
    """A failure probability too small for plain draws.

    Importance sampling around the design points, the failures nearest to the median draw, takes some hundred
    simulations. Where it has no answer, adaptive multilevel splitting approaches failures level by level, which takes
    some hundred thousand. Plain draws check the answer, and their number bounds the failures that it may miss. The
    study's [sweep] and its number of draws are ignored.
    """

    method: Annotated[
        RareMethod, typer.Option("--method", help="auto: importance sampling, or splitting where that has no answer.")
    ] = RareMethod.AUTO
    variation: Annotated[
        float,
        typer.Option("--variation", metavar="V", help="Coefficient of variation to reach by importance sampling."),
    ] = VARIATION
    particles: Annotated[int, typer.Option("--particles", metavar="N", help="Particles of each repeat.")] = PARTICLES
    killed: Annotated[
        int | None, typer.Option("--killed", metavar="K", help="Particles killed at each level [N/2].")
    ] = None
    moves: Annotated[int, typer.Option("--moves", metavar="M", help="Steps of a clone at each level.")] = MOVES
    repeats: Annotated[
        int, typer.Option("--repeats", metavar="R", help=f"Independent repeats, at least {LEAST_REPEATS}.")
    ] = REPEATS
    plain: Annotated[
        int | None,
        typer.Option(
            "--plain", metavar="N", help=f"Plain draws that check the answer [{FEWER_PLAIN}; splitting: {PLAIN}]."
        ),
    ] = None
