"""Options of the commands that search: tune, select, falsify, worst-wind."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import typer

from dssc_jax.analyses.defaults import BUDGET, CLIMBS, INDIFFERENCE, KEPT, MOST_RACED, RACED, ROUNDS, SEGMENTS
from dssc_jax.cli.declarations.types import DrawsOptions, Json, NoCheck, OutputOptions, SeededOptions

Budget = Annotated[
    int, typer.Option("--budget", metavar="N", help="Simulations of a hunt; one with derivatives counts for several.")
]


@dataclass(frozen=True, kw_only=True)
class Tune(DrawsOptions):
    """Tune what the study's [tune] names, by gradient.

    Training draws are descended on, validation draws choose, and the study's own draws, on which nothing was tuned,
    decide: exit 1 where a limit or requirement is not met on the validation draws, or a hunt still finds a failure.
    Where [tune] asks for a proof, the folder holds the result's certificate, proof.json, which `prove` verifies.
    """

    synonyms: ClassVar = ("optimise", "optimize", "autotune")

    robust: Annotated[
        bool, typer.Option("--robust", help="Hunt the result's worst case, add it to the draws, tune again.")
    ] = False
    rounds: Annotated[int, typer.Option("--rounds", metavar="N", help="Rounds of --robust at most.")] = ROUNDS
    budget: Budget = BUDGET
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="The tuned study [results/NAME-tune/tuned.toml].")
    ] = None
    no_check: NoCheck = False
    as_json: Json = False


@dataclass(frozen=True, kw_only=True)
class Select(OutputOptions, SeededOptions):
    """The candidates among many values of some numbers that fail least often.

    Candidates are spread evenly in the logarithm of the ranges, and all are simulated on the same draws. Those that are
    surely not among the best leave the race early. With 95 % confidence, each chosen candidate fails at most --within
    more often than any that was not chosen. The draws differ from the study's own; `run` judges the choice on those.
    The study's [sweep] and number of draws are ignored.
    """

    synonyms: ClassVar = ("best", "rank", "gains")

    over: Annotated[
        list[str] | None,
        typer.Option(
            "--over", metavar="NAME=LO:HI", help="A number and its range; may be repeated [the controller's gains]."
        ),
    ] = None
    candidates: Annotated[int, typer.Option("--candidates", metavar="N", help="Number of candidates.")] = RACED
    keep: Annotated[int, typer.Option("--keep", metavar="K", help="Number of candidates to choose.")] = KEPT
    within: Annotated[
        float, typer.Option("--within", metavar="D", help="Difference of failure probabilities that does not matter.")
    ] = INDIFFERENCE
    most: Annotated[int, typer.Option("--most", metavar="N", help="Largest number of simulations.")] = MOST_RACED


@dataclass(frozen=True, kw_only=True)
class Falsify(OutputOptions, SeededOptions):
    """Hunt the worst draw: within the support of the laws, within K sigma, or within the likeliest share P.

    The distance of a draw in sigma is that of its standard normal scores z from 0, over all uncertain numbers together;
    scores of correlated numbers are made independent. The worst draw and the likeliest failure found are printed with
    their distance, relative log density, and the probability of draws at most that far.

    Exit 1 where one fails. The witness is written as a study (witness.toml, for `simulate`) and as a result of that one
    draw (the folder witness, for `replay`).
    """

    synonyms: ClassVar = ("worst", "worst-case", "attack")

    budget: Budget = BUDGET
    within_sigma: Annotated[
        float | None,
        typer.Option("--within-sigma", metavar="K", help="Only draws within K sigma: |z| <= K, z the laws' scores."),
    ] = None
    within_mass: Annotated[
        float | None,
        typer.Option("--within-mass", metavar="P", help="Only the likeliest draws that have the probability P."),
    ] = None
    requirement: Annotated[
        str | None,
        typer.Option("--requirement", metavar="NAME", help="Only this requirement counts, by its name in results."),
    ] = None
    search_seed: Annotated[int, typer.Option("--search-seed", metavar="S", min=0, help="Seed of the search.")] = 0


@dataclass(frozen=True, kw_only=True)
class WorstWind(OutputOptions, SeededOptions):
    """Find the wind within bounds that drives each signal of a flight to its worst value.

    The wind of the study has bounds: [wind] kind = "bounded", or another kind that declares its own. Winds that swing
    in resonance with the loop and winds that switch at random come first; the worst of them climb along the gradient of
    the signal, with the uncertain numbers of the study moving within the support of their laws.

    The result is a lower bound of what such winds can do. Each worst flight is written as a study (flights/SIGNAL.toml,
    for `simulate`), and its wind as CSV. The study's [sweep] is ignored.
    """

    signal: Annotated[
        list[str] | None,
        typer.Option(
            "--signal", metavar="NAME", help="Only this signal, such as error_max_x or tilt_max; may be repeated."
        ),
    ] = None
    segments: Annotated[
        int, typer.Option("--segments", metavar="N", help="Parts of the flight, between which a wind may change.")
    ] = SEGMENTS
    rounds: Annotated[int, typer.Option("--rounds", metavar="N", help="Steps of a climb at most.")] = CLIMBS
    search_seed: Annotated[int, typer.Option("--search-seed", metavar="S", min=0, help="Seed of the search.")] = 0
