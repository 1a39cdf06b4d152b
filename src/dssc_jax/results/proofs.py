"""Proofs of a sweep's points: as a record, and as a file of a results folder."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.json_types import JsonObject
from dssc_jax.study import Study

PROOFS_FILE = "proofs.json"


@dataclass(frozen=True)
class SweepProofs:
    """What is proved at each point of a sweep.

    Args:
        study_hash: Hash of the study.
        axes: Values of each swept parameter.
        points: Summary of each point's proof; the last axis varies fastest.
        certificates: Certificate of each point.
        seconds: Time spent.
    """

    study_hash: str
    axes: dict[str, tuple[float, ...]]
    points: list[JsonObject]
    certificates: list[JsonObject]
    seconds: float

    @property
    def proved(self) -> np.ndarray:
        """Whether each point is proved for all its plants, by axes."""
        return self._by_axes([point["proved"] for point in self.points])

    @property
    def error(self) -> np.ndarray:
        """Proved upper bound of |e| [m] once settled, by axes; NaN where the point is not proved."""
        return self._by_axes([point["error"] if point["proved"] else np.nan for point in self.points])

    def _by_axes(self, values: list[float]) -> np.ndarray:
        return np.array(values).reshape([len(axis) for axis in self.axes.values()])

    def save(self, folder: str | Path) -> Path:
        """Write the proofs with their certificates into a results folder."""
        path = Path(folder) / PROOFS_FILE
        files.write_text(path, json.dumps(asdict(self), allow_nan=False) + "\n")
        return path


def read_proofs(folder: Path, study: Study) -> SweepProofs | None:
    """The proofs in a results folder; None if there are none, or if they are another study's.

    They are what the folder claims. ``dssc-jax prove FOLDER/proofs.json`` verifies every certificate.

    Raises:
        ConfigError: the file is damaged.
    """
    path = folder / PROOFS_FILE
    if not path.exists():
        return None
    try:
        content = json.loads(files.read_text(path))
        axes = {name: tuple(values) for name, values in content["axes"].items()}
        proofs = SweepProofs(**{**content, "axes": axes})
        proofs.error  # noqa: B018  (as many points as the axes have, each with its fields)
    except OSError as error:
        raise ConfigError(str(path), f"cannot be read: {error.strerror}") from None
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ConfigError(str(path), f"is damaged: {error!r}; delete it, and prove the sweep again") from None
    return proofs if proofs.study_hash == study.hash and axes == study.axes else None
