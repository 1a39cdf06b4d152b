"""Proofs of the points of a sweep, and their file in a results folder."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.json_types import JsonObject
from dssc_jax.proofs.claims import AXIS_CLAIM, VEHICLE_BOUNDS, Claim, claim_of_proof
from dssc_jax.study import Study

PROOFS_FILE = "proofs.json"


class Bound(NamedTuple):
    """A bound that the proof of a vehicle states, and its place in the summary of the proof.

    Args:
        label: Name of the bounded quantity.
        unit: Unit of the bound.
        entries: Keys of the nested tables in a summary's ``bounds`` that lead to the bound.
    """

    label: str
    unit: str
    entries: tuple[str, ...]

    def of(self, content: JsonObject) -> float:
        """The value of the bound, from the entry ``bounds`` of a proof's summary."""
        *parents, leaf = self.entries
        for parent in parents:
            content = content[parent]
        return float(content[leaf])


BOUNDS = (
    Bound("|e_x|, |e_y|", "m", ("x", "e")),
    Bound("|e_z|", "m", ("z", "e")),
    Bound("|e_psi|", "rad", ("psi", "e")),
    Bound("tilt", "rad", ("tilt",)),
    Bound("smallest thrust of a rotor", "N", ("rotor_min",)),
    Bound("largest thrust of a rotor", "N", ("rotor_max",)),
)
"""Bounds that are reported for each proved point of a vehicle's sweep."""


@dataclass(frozen=True)
class SweepProofs:
    """The proofs of the points of a sweep.

    Args:
        study_hash: Hash of the study.
        axes: Values of each swept parameter.
        points: Summary of the proof of each point; the last axis varies fastest.
        certificates: Certificate of each point, in the same order.
        seconds: Computing time of all proofs [s].
    """

    study_hash: str
    axes: dict[str, tuple[float, ...]]
    points: list[JsonObject]
    certificates: list[JsonObject]
    seconds: float

    @property
    def proved(self) -> np.ndarray:
        """Whether each point is proved for all plants that are possible there, shape (axes...)."""
        return self._by_axes([point["proved"] for point in self.points])

    @property
    def error(self) -> np.ndarray:
        """Proved upper bound of |e| [m] in the settled loop, shape (axes...); NaN where the point is not proved."""
        return self._by_axes([point["error"] if point["proved"] else np.nan for point in self.points])

    @property
    def claim(self) -> Claim:
        """What the proofs cover and bound, in words."""
        return claim_of_proof(self.points[0]) if self.points else AXIS_CLAIM

    @property
    def statements(self) -> list[str]:
        """The proved statement of each point in a few sentences; empty where the point is not proved."""
        return [str(point.get("statement", "")) if point["proved"] else "" for point in self.points]

    @property
    def bounds(self) -> dict[str, np.ndarray]:
        """The bounds that a vehicle never exceeds, by label, in the units of :data:`BOUNDS`, each of shape (axes...).

        A bound is NaN where the point is not proved. The result is empty for loops without a vehicle.
        """
        if not any(VEHICLE_BOUNDS in point for point in self.points):
            return {}
        arrays = {}
        for bound in BOUNDS:
            values = [bound.of(point[VEHICLE_BOUNDS]) if point["proved"] else np.nan for point in self.points]
            arrays[bound.label] = self._by_axes(values)
        return arrays

    def require_complete(self) -> None:
        """Require exactly one point, with all its fields, for each combination of the axes' values.

        Raises:
            ValueError: There are more or fewer points than combinations.
            TypeError, KeyError: A point lacks a field.
        """
        _ = self.error  # reading them raises
        _ = self.bounds

    def _by_axes(self, values: list[float]) -> np.ndarray:
        """Values of the points as an array of shape (axes...)."""
        return np.array(values).reshape([len(axis) for axis in self.axes.values()])

    def save(self, folder: str | Path) -> Path:
        """Write the proofs with their certificates into a results folder."""
        path = Path(folder) / PROOFS_FILE
        files.write_text(path, json.dumps(asdict(self), allow_nan=False) + "\n")
        return path


def read_proofs(folder: Path, study: Study) -> SweepProofs | None:
    """Read the proofs in a results folder; None if the folder has no proofs, or if they belong to another study.

    This function verifies no certificate; ``dssc-jax prove FOLDER/proofs.json`` verifies all of them.

    Raises:
        ConfigError: The file is damaged.
    """
    path = folder / PROOFS_FILE
    if not path.exists():
        return None
    try:
        content = json.loads(files.read_text(path))
        axes = {name: tuple(values) for name, values in content["axes"].items()}  # JSON has lists
        proofs = SweepProofs(**{**content, "axes": axes})
        proofs.require_complete()
    except OSError as error:
        raise ConfigError(str(path), f"cannot be read: {error.strerror}") from None
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ConfigError(str(path), f"is damaged: {error!r}; delete it, and prove the sweep again") from None
    belongs_to_study = proofs.study_hash == study.hash and axes == study.axes
    return proofs if belongs_to_study else None
