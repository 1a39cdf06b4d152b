"""Join several margins over one walk into one dataset, and separate them again."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

import numpy as np
import xarray as xr

from dssc_jax.analyses.margins.result import MarginAnswer, Margins
from dssc_jax.core.json_types import JsonObject
from dssc_jax.core.quantities import Quantity
from dssc_jax.results.analysis import restored_analysis
from dssc_jax.results.fields import MERGED, stored_fields
from dssc_jax.study import Study


def join_margins(margins: Mapping[str, Margins], dimension: str, meaning: str) -> xr.Dataset:
    """Join margins into one dataset along a new dimension; a variable missing from one of them is NaN there.

    Args:
        margins: Margins by name.
        dimension: Name of the new dimension.
        meaning: Meaning of the new dimension.
    """
    axis = xr.DataArray(np.array(list(margins)), dims=dimension, name=dimension, attrs={"long_name": meaning})
    return xr.concat(
        [margin.dataset for margin in margins.values()],
        dim=axis, data_vars="all", coords="minimal", compat="override", join="override", combine_attrs="override",
    )  # fmt: skip


class MarginPart(NamedTuple):
    """The data of one margin that :func:`part_margins` needs besides the joined dataset.

    Args:
        settings: The fields of the margins.
        variables: Their variables of the dataset.
        slack_unit: The unit of their slack.
    """

    settings: JsonObject
    variables: tuple[str, ...]
    slack_unit: str


@dataclass(frozen=True)
class NamedMargins:
    """Margins as a part of an answer."""

    study: Annotated[str, Quantity("", "name of the study")]
    margins: MarginAnswer = field(metadata={MERGED: True})


def median_texts(margins: Mapping[str, Margins]) -> str:
    """Name and median of each of several margins, in one line."""
    texts = []
    for name, margin in margins.items():
        median = margin.median
        texts.append(f"{name} {'before the start' if median is None else f'{median:.4g}'}")
    return ", ".join(texts)


def margin_parts(margins: Mapping[str, Margins]) -> dict[str, MarginPart]:
    """What :func:`part_margins` needs besides the joined dataset, by name."""
    parts = {}
    for name, margin in margins.items():
        variables = tuple(map(str, margin.dataset))
        parts[name] = MarginPart(stored_fields(margin), variables, margin.dataset["slack"].attrs["units"])
    return parts


def part_margins(
    dataset: xr.Dataset, dimension: str, parts: Mapping[str, MarginPart], study_of: Callable[[str], Study]
) -> dict[str, Margins]:
    """Separate joined margins by name.

    Args:
        dataset: The return value of :func:`join_margins`.
        dimension: Its dimension of names.
        parts: The return value of :func:`margin_parts`.
        study_of: The study of each.
    """
    margins = {}
    for name, part in parts.items():
        data = dataset.sel({dimension: name}, drop=True)[list(part.variables)]
        data = data.assign(slack=data["slack"].assign_attrs(units=part.slack_unit))
        margins[name] = restored_analysis(Margins, study_of(name), data, part.settings)
    return margins
