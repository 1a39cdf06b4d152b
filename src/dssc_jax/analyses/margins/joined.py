"""Several margins over one walk as one dataset, and apart again."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import xarray as xr

from dssc_jax.analyses.margins.result import Margins
from dssc_jax.results.analysis_folder import Stored
from dssc_jax.study import Study


def join_margins(margins: Mapping[str, Margins], dimension: str, meaning: str) -> xr.Dataset:
    """One dataset of all, along a new dimension; what one of them does not have is NaN there.

    Args:
        margins: By name.
        dimension: The new one.
        meaning: What it counts.
    """
    axis = xr.DataArray(np.array(list(margins)), dims=dimension, name=dimension, attrs={"long_name": meaning})
    return xr.concat(
        [one.dataset for one in margins.values()],
        dim=axis, data_vars="all", coords="minimal", compat="override", join="override", combine_attrs="override",
    )  # fmt: skip


def margin_settings(margins: Mapping[str, Margins]) -> dict[str, Any]:
    """What the joined dataset does not tell, for JSON."""
    return {
        name: one.settings()
        | {"variables": list(map(str, one.dataset)), "slack_unit": one.dataset["slack"].attrs["units"]}
        for name, one in margins.items()
    }


def part_margins(
    dataset: xr.Dataset, dimension: str, settings: Mapping[str, Any], study_of: Callable[[str], Study]
) -> dict[str, Margins]:
    """The margins by name.

    Args:
        dataset: What :func:`join_margins` returned.
        dimension: Its dimension of names.
        settings: What :func:`margin_settings` returned.
        study_of: The study of each.
    """
    margins = {}
    for name, own in settings.items():
        part = dataset.sel({dimension: name}, drop=True)[own["variables"]]
        part = part.assign(slack=part["slack"].assign_attrs(units=own["slack_unit"]))
        margins[name] = Margins.restored(Stored(study_of(name), part, own))
    return margins
