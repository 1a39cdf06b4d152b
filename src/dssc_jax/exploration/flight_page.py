"""The flight of a vehicle as one HTML file: a draw in three dimensions over time, and other draws as ghosts."""

from itertools import islice

import numpy as np
from bokeh.layouts import column
from bokeh.models import Div
from markupsafe import escape

from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.batching import join_batches, values_of_draws
from dssc_jax.exploration.flight_view import FlightView
from dssc_jax.exploration.interactive_report import standalone_page
from dssc_jax.exploration.live import VEHICLE_BATCH, LiveRun, has_vehicle, recorded_signals
from dssc_jax.runs.recorded_draws import RecordedDraws
from dssc_jax.study import Study

GHOSTS = 32
"""Usual number of other draws that are shown beside the selected one."""


def flight_html(study: Study, draw: int = 0, ghosts: int = GHOSTS) -> str:
    """Return an HTML page with the flight of a draw and a slider of time.

    The page needs no network, and no program behind it.

    Args:
        study: A study of a vehicle; its sweep is ignored.
        draw: Index of the draw.
        ghosts: Largest number of other draws that are shown; the first ones are taken.

    Raises:
        ConfigError: The plant has no position and attitude, or there is no such draw.
    """
    fixed = study.without_sweep()
    if not has_vehicle(fixed):
        raise ConfigError(fixed.source, "is no study of a vehicle: a flight needs x, y, z and an attitude")
    if not 0 <= draw < fixed.config.draws:
        raise ConfigError(fixed.source, f"draw must be in 0 .. {fixed.config.draws - 1}, got {draw}")
    other_draws = (index for index in range(fixed.config.draws) if index != draw)
    indices = np.array([draw, *islice(other_draws, ghosts)])
    program = RecordedDraws(fixed, {}, recorded_signals(fixed), lanes=VEHICLE_BATCH)
    results = join_batches(list(program.batches(fixed, indices)))
    values_of_all = values_of_draws(fixed, slice(0, int(indices.max()) + 1))
    values = {name: column[indices] for name, column in values_of_all.items()}
    run = LiveRun(fixed, results, values, program.times)
    view = FlightView()
    view.show(run, 0, name=str(draw))
    required = "; ".join(requirement.text for requirement in fixed.requirements) or "nothing"
    text = f"<h1>{escape(fixed.name)}</h1><p>required: {escape(required)}</p>"
    return standalone_page(f"{fixed.name}: flight", column(Div(text=text, disable_math=True), view.layout))
