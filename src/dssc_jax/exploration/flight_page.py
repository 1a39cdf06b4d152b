"""A vehicle's flight over time as one file: a chosen draw in three dimensions, other draws as ghosts."""

import numpy as np
from bokeh.layouts import column
from bokeh.models import Div
from markupsafe import escape

from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.batching import values_of_draws
from dssc_jax.exploration.flight_view import FlightView
from dssc_jax.exploration.interactive_report import standalone
from dssc_jax.exploration.live import VEHICLE_BATCH, LiveRun, flies, recorded_signals
from dssc_jax.runs.recorded_draws import RecordedDraws, all_draws
from dssc_jax.study import Study

GHOSTS = 32


def flight_html(study: Study, draw: int = 0, ghosts: int = GHOSTS) -> str:
    """A page that needs no network and no program: the flight of a draw with a slider of time.

    Args:
        study: A study of a vehicle; a sweep is ignored.
        draw: Index of the draw.
        ghosts: Number of other draws to show, from the first one on.

    Raises:
        ConfigError: The study's plant has no place and attitude, or there is no such draw.
    """
    fixed = study.without_sweep()
    if not flies(fixed):
        raise ConfigError(fixed.source, "is no study of a vehicle: a flight needs x, y, z and an attitude")
    if not 0 <= draw < fixed.config.draws:
        raise ConfigError(fixed.source, f"draw must be in 0 .. {fixed.config.draws - 1}, got {draw}")
    indices = np.unique([draw, *range(min(ghosts + 1, fixed.config.draws))])
    companions = indices[indices != draw][:ghosts]
    indices = np.concatenate([[draw], companions])
    program = RecordedDraws(fixed, {}, recorded_signals(fixed), lanes=VEHICLE_BATCH)
    results = all_draws(list(program.batches(fixed, indices)))
    values_of_all = values_of_draws(fixed, slice(0, int(indices.max()) + 1))
    values = {name: column[indices] for name, column in values_of_all.items()}
    run = LiveRun(fixed, results, values, program.times)
    view = FlightView()
    view.show(run, 0, name=str(draw))
    required = "; ".join(requirement.text for requirement in fixed.requirements) or "nothing"
    text = f"<h1>{escape(fixed.name)}</h1><p>required: {escape(required)}</p>"
    return standalone(f"{fixed.name}: flight", column(Div(text=text, disable_math=True), view.layout))
