"""Join several margins over the same walk into a dataset, and separate them again."""

from collections.abc import Callable, Iterable, Mapping
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


def name_axis(dimension: str, names: Iterable[str], meaning: str) -> xr.DataArray:
    """The coordinate of a dimension of a dataset whose elements have names.

    Args:
        dimension: Name of the dimension.
        names: Name of each element along the dimension, in order.
        meaning: What the elements are, in words; the coordinate's ``long_name``.
    """
    return xr.DataArray(np.array(list(names)), dims=dimension, name=dimension, attrs={"long_name": meaning})


def join_margins(margins: Mapping[str, Margins], dimension: str, meaning: str) -> xr.Dataset:
    """Join the datasets of margins along a new dimension of names; :func:`split_margins` separates them again.

    A variable that only some of the margins have is NaN for the others.

    Args:
        margins: Margins by name.
        dimension: Name of the new dimension.
        meaning: Meaning of the new dimension.
    """
    return xr.concat(
        [margin.dataset for margin in margins.values()], dim=name_axis(dimension, margins, meaning),
        data_vars="all", coords="minimal", compat="override", join="override", combine_attrs="override",
    )  # fmt: skip


class MarginPart(NamedTuple):
    """Facts about one of several joined margins that the joined dataset lacks; :func:`split_margins` needs them.

    Args:
        settings: The fields of :class:`Margins` besides study and dataset, as JSON.
        variables: Names of the margin's variables in the joined dataset.
        slack_unit: Unit of the margin's slack, which may differ between margins.
    """

    settings: JsonObject
    variables: tuple[str, ...]
    slack_unit: str


@dataclass(frozen=True)
class NamedMargins:
    """The answer for the margins of one study, with the study's name, as a part of an answer for several studies."""

    study: Annotated[str, Quantity("", "name of the study")]
    margins: MarginAnswer = field(metadata={MERGED: True})


def medians_text(margins: Mapping[str, Margins]) -> str:
    """The name and the median critical value of each of several margins, as in ``dssc 0.41, sta before the start``."""
    texts = []
    for name, margin in margins.items():
        median_text = "before the start" if margin.median is None else f"{margin.median:.4g}"
        texts.append(f"{name} {median_text}")
    return ", ".join(texts)


def margin_parts(margins: Mapping[str, Margins]) -> dict[str, MarginPart]:
    """The facts about each margin that a joined dataset lacks, by name of the margin, for :func:`split_margins`."""
    parts = {}
    for name, margin in margins.items():
        parts[name] = MarginPart(
            settings=stored_fields(margin),
            variables=tuple(map(str, margin.dataset)),
            slack_unit=margin.dataset["slack"].attrs["units"],
        )
    return parts


def split_margins(
    dataset: xr.Dataset, dimension: str, parts: Mapping[str, MarginPart], study_of: Callable[[str], Study]
) -> dict[str, Margins]:
    """Split a joined dataset into the margins that :func:`join_margins` was given, by name.

    Args:
        dataset: The joined dataset.
        dimension: The dimension of the dataset along which the margins are joined.
        parts: The return value of :func:`margin_parts` for these margins.
        study_of: (name of a margin) -> its study.
    """
    margins = {}
    for name, part in parts.items():
        data = dataset.sel({dimension: name}, drop=True)[list(part.variables)]
        data = data.assign(slack=data["slack"].assign_attrs(units=part.slack_unit))  # the join kept only one unit
        margins[name] = restored_analysis(Margins, study_of(name), data, part.settings)
    return margins
