"""Commands for statistics: plan, sensitivity, rare."""

import json
from typing import Annotated

import typer

from dssc_jax.analyses.defaults import LEAST_REPEATS, MOVES, PARTICLES, PLAIN, REPEATS
from dssc_jax.cli import options as opt
from dssc_jax.cli.common import DONE, app, default_out, load_study, output_analysis, save_analysis
from dssc_jax.core.errors import ConfigError

ConfidenceOption = Annotated[float, typer.Option("--confidence", metavar="C", help="Confidence of every statement.")]


@app.command()
def plan(
    error: Annotated[
        float, typer.Option("--error", metavar="E", help="Accuracy of a probability, or share beyond a limit.")
    ] = 0.05,
    confidence: ConfidenceOption = 0.95,
    probability: Annotated[
        float | None, typer.Option("--probability", metavar="P", help="Failure probability that you expect.")
    ] = None,
    as_json: opt.Json = False,
) -> int:
    """How many draws does my question need?

    Answers for a failure probability (Chernoff; Clopper-Pearson, at the expected count and assured), for the worst case
    and for no failure at all, and for tolerance limits (Wilks).
    """
    from dssc_jax.console.terminal import show_table
    from dssc_jax.statistics import plan as answers

    try:
        plans = answers(error, confidence, probability)
    except ValueError as wrong:
        raise ConfigError("plan", str(wrong)) from None
    if as_json:
        about = {"error": error, "confidence": confidence, "probability": probability}
        print(json.dumps({**about, "answers": [answer._asdict() for answer in plans]}))
    else:
        rows = [(answer.question, str(answer.draws), answer.statement) for answer in plans]
        show_table(("question", "draws", "what one may say then"), rows)
    return DONE


@app.command()
def sensitivity(
    study: opt.StudyArgument,
    method: Annotated[
        str, typer.Option("--method", metavar="NAME", help="sobol, shapley (numbers may be correlated) or morris.")
    ] = "sobol",
    settings: opt.Set = None,
    draws: opt.Draws = None,
    seed: opt.Seed = None,
    out: opt.Out = None,
    no_check: opt.NoCheck = False,
    as_json: opt.Json = False,
    allow_local: opt.Local = False,
) -> int:
    """Which uncertain numbers matter, for each metric and for failure?

    sobol: first-order and total indices; shapley: the variance shared out among numbers that may be correlated. The
    draws, rounded down to a power of two, are the rows of a sample that is simulated about once for each number. If
    failures are too rare, the answer is the number of rows that they need. morris: a screening of many numbers; the
    draws are the total number of simulations. All with intervals. The study's [sweep] is ignored.
    """
    from dssc_jax.analyses.sensitivity import sensitivity as indices
    from dssc_jax.console.analyses import show_sensitivity
    from dssc_jax.console.terminal import progress_bar
    from dssc_jax.results.analysis_folder import require_free

    loaded = load_study(study, settings, draws, seed, allow_local).without_sweep()
    folder = out or default_out(loaded, "sensitivity", method, settings, draws, seed)
    require_free(folder, "sensitivity", loaded)
    with progress_bar(loaded, quiet=as_json) as advance:
        result = indices(loaded, method, progress=advance)
    output_analysis(
        result, {"result": folder}, save_analysis(result, folder, check=not no_check), as_json, show_sensitivity
    )
    return DONE


@app.command()
def rare(
    study: opt.StudyArgument,
    particles: Annotated[int, typer.Option("--particles", metavar="N", help="Particles of each repeat.")] = PARTICLES,
    killed: Annotated[
        int | None, typer.Option("--killed", metavar="K", help="Particles killed at each level [N/2].")
    ] = None,
    moves: Annotated[int, typer.Option("--moves", metavar="M", help="Steps of a clone at each level.")] = MOVES,
    repeats: Annotated[
        int, typer.Option("--repeats", metavar="R", help=f"Independent repeats, at least {LEAST_REPEATS}.")
    ] = REPEATS,
    plain: Annotated[int, typer.Option("--plain", metavar="N", help="Plain draws, which may contradict.")] = PLAIN,
    settings: opt.Set = None,
    seed: opt.Seed = None,
    out: opt.Out = None,
    no_check: opt.NoCheck = False,
    as_json: opt.Json = False,
    allow_local: opt.Local = False,
) -> int:
    """A failure probability too small for plain draws.

    Adaptive multilevel splitting on the smallest slack of a requirement: failures are approached level by level. The
    interval comes from independent repeats; plain draws show where it cannot be right. The study's [sweep]
    and its number of draws are ignored.
    """
    from dssc_jax.analyses.rare_events.rare import rare as estimate
    from dssc_jax.analyses.rare_events.splitting import Splitting
    from dssc_jax.console.analyses import show_rare
    from dssc_jax.console.terminal import progress_bar
    from dssc_jax.results.analysis_folder import require_free

    loaded = load_study(study, settings, None, seed, allow_local).without_sweep()
    spent = Splitting(particles, particles // 2 if killed is None else killed, moves, repeats, plain=plain)
    folder = out or default_out(loaded, "rare", settings, seed)
    require_free(folder, "rare", loaded)
    with progress_bar(loaded, quiet=as_json, of="simulations") as advance:
        event = estimate(loaded, spent, progress=advance)
    output_analysis(event, {"result": folder}, save_analysis(event, folder, check=not no_check), as_json, show_rare)
    return DONE
