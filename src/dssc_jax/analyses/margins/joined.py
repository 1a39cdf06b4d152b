"""Join several margins over one walk into one dataset, and separate them again."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import xarray as xr

from dssc_jax.analyses.margins.result import Margins
from dssc_jax.results.analysis_folder import Stored
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
        [one.dataset for one in margins.values()],
        dim=axis, data_vars="all", coords="minimal", compat="override", join="override", combine_attrs="override",
    )  # fmt: skip


def margin_settings(margins: Mapping[str, Margins]) -> dict[str, Any]:
    """What :func:`part_margins` needs besides the joined dataset, for JSON."""
    return {
        name: one.settings()
        | {"variables": list(map(str, one.dataset)), "slack_unit": one.dataset["slack"].attrs["units"]}
        for name, one in margins.items()
    }


def part_margins(
    dataset: xr.Dataset, dimension: str, settings: Mapping[str, Any], study_of: Callable[[str], Study]
) -> dict[str, Margins]:
    """Separate joined margins by name.

    Args:
        dataset: The return value of :func:`join_margins`.
        dimension: Its dimension of names.
        settings: The return value of :func:`margin_settings`.
        study_of: The study of each.
    """
    margins = {}
    for name, own in settings.items():
        part = dataset.sel({dimension: name}, drop=True)[own["variables"]]
        part = part.assign(slack=part["slack"].assign_attrs(units=own["slack_unit"]))
        margins[name] = Margins.restored(Stored(study_of(name), part, own))
    return margins
