"""The dataset of classical margins: margins, responses and disk margins of all draws as variables."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

from dssc_jax.analyses.loop_margins.fans import FAN_LEVELS, FANS, fan_quantiles
from dssc_jax.analyses.loop_margins.multiloop import MultiloopMargins
from dssc_jax.analyses.loop_margins.result import MARGIN_KINDS, LoopMargins, Status
from dssc_jax.core.quantities import unit_and_meaning
from dssc_jax.study import Study

LINES = 60  # number of draws whose frequency responses are stored

Variable = tuple[tuple[str, ...], np.ndarray, Mapping[str, object]]
"""A variable of a dataset: its dimensions, values and attributes."""


class BrokenLoop(NamedTuple):
    """Margins and frequency responses of all draws at one break point and one operating point.

    Args:
        margins: Margins by name, shape (draws,) each; NaN for a draw without margins.
        status: A :class:`Status` for each draw, shape (draws,).
        response: G = -T on the common grid of frequencies, shape (draws, frequencies), with the complementary
            sensitivity T = L/(1 + L).
        poles: Poles of the loop transfer function L, shape (draws, states); NaN for a draw without an operating point
            within the limits.
    """

    margins: dict[str, np.ndarray]
    status: np.ndarray
    response: np.ndarray
    poles: np.ndarray


def multiloop_dataset(multiloop: Mapping[str, MultiloopMargins | None]) -> xr.Dataset:
    """The disk margins of all loops at once as variables of a dataset, along ``operating_point`` and ``draw``.

    The dataset is empty if an operating point has no such margins, or if the channels differ between operating points.

    Args:
        multiloop: The margins of all draws, by operating point; None for a point without such margins.
    """
    margins = [at_point for at_point in multiloop.values() if at_point is not None]
    has_gap = len(margins) < len(multiloop)
    if has_gap or len({at_point.channels for at_point in margins}) > 1:
        return xr.Dataset()
    dims = ("operating_point", "draw")
    channel_dims = (*dims, "channel")
    guaranteed = [at_point.guaranteed for at_point in margins]
    attained = [at_point.attained for at_point in margins]
    frequencies = [at_point.frequency for at_point in margins]
    factors = np.stack([at_point.factors for at_point in margins])
    of_perturbation = "of the perturbation that was found"
    columns = {  # dimensions, values, unit, meaning
        "disk": (dims, guaranteed, "1", "disk margin alpha of all loops at once"),
        "found": (dims, attained, "1", "alpha of a perturbation that was found"),
        "frequency": (dims, frequencies, "rad/s", "critical frequency"),
        "gain": (channel_dims, np.abs(factors), "1", f"gain {of_perturbation}"),
        "phase": (channel_dims, np.angle(factors), "rad", f"phase {of_perturbation}"),
    }
    variables = {}
    for name, (dimensions, values, unit, meaning) in columns.items():
        variables[f"multiloop_{name}"] = (dimensions, np.stack(values), unit_and_meaning(unit, meaning))
    return xr.Dataset(variables, coords={"channel": list(margins[0].channels)})


def margins_dataset(
    study: Study, answers: Mapping[str, Mapping[str, BrokenLoop]], frequencies: np.ndarray
) -> xr.Dataset:
    """The dataset of :class:`LoopMargins`, without the margins of all loops at once.

    Args:
        study: The study.
        answers: Margins and responses of all draws, by operating point and break point. A break point that is missing
            at some operating point gets :func:`blank_loop` there.
        frequencies: Frequencies of the responses [rad/s], shape (frequencies,).
    """
    points = list(answers)
    loops: list[str] = []  # each once, in order
    for by_loop in answers.values():
        loops += [loop for loop in by_loop if loop not in loops]
    draws = study.config.draws
    blank = blank_loop(draws, frequencies.size)
    broken_loops = []  # point by point
    for point in points:
        broken_loops += [answers[point].get(loop, blank) for loop in loops]
    shape = (len(points), len(loops))
    variables = margin_variables(broken_loops, shape)
    variables |= response_variables(broken_loops, shape, frequencies, study.config.loop.sample_time)
    coords = {
        "operating_point": ("operating_point", np.array(points), {"long_name": "where the loop is linearised"}),
        "loop": ("loop", np.array(loops), {"long_name": "where the loop is broken"}),
        "draw": ("draw", np.arange(draws), {"long_name": "draw index"}),
        "level": ("level", np.array(FAN_LEVELS), unit_and_meaning("1", "level of the quantile")),
        "frequency": ("frequency", frequencies, unit_and_meaning("rad/s", "frequency")),
    }
    return xr.Dataset(variables, coords=coords, attrs={"title": study.name})


def blank_loop(draws: int, frequencies: int) -> BrokenLoop:
    """The entry for a break point at which no draw has a closed loop: every margin and response is NaN.

    Args:
        draws: Number of draws.
        frequencies: Number of frequencies.
    """
    return BrokenLoop(
        margins={name: np.full(draws, np.nan) for name in MARGIN_KINDS},
        status=np.full(draws, Status.NO_OPERATING_POINT.value),
        response=np.full((draws, frequencies), np.nan, complex),
        poles=np.full((draws, 0), np.nan, complex),
    )


def margin_variables(broken_loops: Sequence[BrokenLoop], shape: tuple[int, int]) -> dict[str, Variable]:
    """The margins and the status of all draws as variables of a dataset.

    Args:
        broken_loops: Margins of all draws: all break points of the first operating point, then those of the next.
        shape: Number of operating points, then of break points.
    """
    variables: dict[str, Variable] = {}
    for name, kind in MARGIN_KINDS.items():
        values = np.stack([broken.margins[name] for broken in broken_loops]).reshape(*shape, -1)
        variables[name] = (LoopMargins.table, values, unit_and_meaning(kind.unit, kind.meaning))
    status = np.stack([broken.status for broken in broken_loops]).reshape(*shape, -1)
    attributes = {
        "long_name": "whether the loop has margins",
        "flag_values": [status.value for status in Status],
        "flag_meanings": " ".join(status.name.lower() for status in Status),
    }
    variables["status"] = (LoopMargins.table, status, attributes)
    return variables


def response_variables(
    broken_loops: Sequence[BrokenLoop], shape: tuple[int, int], frequencies: np.ndarray, sample_time: float
) -> dict[str, Variable]:
    """Fans of the frequency responses, and the loop transfer function of some draws, as variables of a dataset.

    Args:
        broken_loops: Responses of all draws: all break points of the first operating point, then those of the next.
        shape: Number of operating points, then of break points.
        frequencies: Frequencies of the responses [rad/s], shape (frequencies,).
        sample_time: T_s [s].
    """
    angles = frequencies * sample_time
    places = LoopMargins.table[:2]  # operating point and break point
    with np.errstate(all="ignore"):
        fans = [fan_quantiles(broken.response, broken.poles, angles) for broken in broken_loops]
        plotted = np.stack([(-broken.response / (1.0 + broken.response))[:LINES] for broken in broken_loops])
    variables: dict[str, Variable] = {}
    for name, (unit, meaning) in FANS.items():
        values = np.stack([fan[name] for fan in fans]).reshape(*shape, len(FAN_LEVELS), -1)
        attributes = unit_and_meaning(unit, f"{meaning}, quantile over the draws")
        variables[name] = ((*places, "level", "frequency"), values, attributes)
    for name, part in (("real", np.real(plotted)), ("imaginary", np.imag(plotted))):
        values = part.reshape(*shape, -1, frequencies.size)
        attributes = unit_and_meaning("1", f"{name} part of the loop transfer function L")
        variables[f"loop_{name}"] = ((*places, "line", "frequency"), values, attributes)
    return variables
