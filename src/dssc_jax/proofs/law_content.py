"""A controller's functions and its nominal control in plain numbers, as problems and certificates hold them."""

from typing import NamedTuple

from dssc_jax.core.json_types import JsonObject
from dssc_jax.models.controllers.gain_functions import GAIN_FUNCTIONS
from dssc_jax.models.controllers.nominal import NominalGains
from dssc_jax.proofs.problem import NominalControl


def functions_content(functions: NamedTuple) -> JsonObject:
    """Make the entry ``functions`` of a problem: the functions' kind and their constants, in one table.

    Args:
        functions: The state-dependent functions of a controller, a member of a row of :data:`GAIN_FUNCTIONS`.

    Returns:
        The row's name as ``kind``, and each constant by its name; a constant that is None is left out.
    """
    kind = next(kind for kind, entry in GAIN_FUNCTIONS.items() if isinstance(functions, entry.members[None]))
    constants = {name: float(value) for name, value in functions._asdict().items() if value is not None}
    return {"kind": kind, **constants}


def nominal_content(nominal: NominalGains | None) -> NominalControl | None:
    """Make the entry ``nominal`` of a problem from a controller's gains; None if it has no nominal control."""
    if nominal is None:
        return None
    return NominalControl(float(nominal.a), float(nominal.k), bool(nominal.predictor_term))
