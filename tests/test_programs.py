"""Three programs of one lane agree: the engine's, the plain one of a batch, and one lane alone; for random studies."""

from random import Random
from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.contracts import Disturbance
from dssc_jax.core.quantities import Quantity
from dssc_jax.engine.batching import lane_of_study
from dssc_jax.engine.plain import plain_options
from dssc_jax.engine.reference import agreement, lane_numbers, recompute
from dssc_jax.models.actuators import UNMODELLED
from dssc_jax.models.differentiators import DIFFERENTIATORS
from dssc_jax.models.disturbances import DISTURBANCES
from dssc_jax.models.references import REFERENCES
from dssc_jax.models.sensors import SENSORS
from tests.test_protocols import (
    FUNCTIONS,
    NOMINAL,
    NORM_BOUND,
    PLANT_TABLES,
    controller_examples,
    examples,
    has_free_functions,
)

ENTRIES = 2000
TABLES = np.linspace(0.0, 1.0, ENTRIES), np.linspace(0.0, 1.0, ENTRIES)
TABLES[1][500:1500] += 1.0  # where NumPy's printed text of so long an array has dots


class TabulatedParams(NamedTuple):
    at: Annotated[float, Quantity("1", "place in the tables", at_least=0.0, at_most=1.0)] = 0.5


def looked_up(params, key):
    """The difference of two tables; 0.1 m/s in the middle."""
    entry = jnp.round(params.at * (ENTRIES - 1)).astype(jnp.int32)
    one, other = (jnp.asarray(table)[entry] for table in TABLES)
    return 0.1 * (other - one)


TABULATED = Disturbance(
    TabulatedParams,
    init=looked_up,
    step=lambda params, state, key, t, dt: state,
    value=lambda params, state, measurement, sigma, t: state,
)


def controller_tables():
    """Each controller's example; one with state-dependent functions with each kind of them, and of modulation."""
    for table in controller_examples():
        if not has_free_functions(table):
            yield table
            continue
        for i, (kind, numbers) in enumerate(FUNCTIONS.items()):
            yield table | {"functions": {"kind": kind, **numbers}, "rho": (2.0, NORM_BOUND)[i % 2]}


CONTROLLER_TABLES = list(controller_tables())
COUNT = len(CONTROLLER_TABLES)
REFERENCE_TABLES = [*examples(REFERENCES), {"kind": "ramp", "slope": {"uniform": [0.2, 0.4]}, "rise": 0.5}]
SENSOR_TABLES = [
    *examples(SENSORS),
    {"kind": "noisy", "velocity_std": 0.02, "velocity_resolution": 0.01, "loss": 0.1, "jitter": 0.005},
]
DIFFERENTIATOR_TABLES = examples(DIFFERENTIATORS)
DISTURBANCE_TABLES = [
    *examples(DISTURBANCES),
    {"kind": "constant", "value": {"uniform": [0.1, 0.3]}},
    {"kind": "filtered_noise", "std": {"uniform": [0.1, 0.2]}, "correlation_time": 0.5},
    {"kind": "tests.test_programs:TABULATED", "at": {"uniform": [0.3, 0.7]}},
]


def shuffled(random, tables, count):
    """So many tables, each of the given ones among them."""
    chosen = [tables[i % len(tables)] for i in range(count)]
    random.shuffle(chosen)
    return chosen


def random_studies(seed=20, count=COUNT):
    """Tables of studies in which every kind of part occurs."""
    random = Random(seed)
    slots = {
        "plant": PLANT_TABLES,
        "controller": CONTROLLER_TABLES,
        "reference": REFERENCE_TABLES,
        "sensor": SENSOR_TABLES,
        "differentiator": DIFFERENTIATOR_TABLES,
        "unmodelled": examples(UNMODELLED),
        "disturbance": DISTURBANCE_TABLES,
    }
    columns = {slot: shuffled(random, tables, count) for slot, tables in slots.items()}
    for i in range(count):
        study = {slot: dict(column[i]) for slot, column in columns.items()}
        if study["plant"]["kind"] == "normal_form":
            study["plant"] |= {"k_p": {"uniform": [0.8, 1.2]}, "a_p": {"uniform": [0.8, 1.2]}}
        substeps, steps = random.choice([1, 2, 3]), random.choice([60, 61])
        loop = {"sample_time": 0.02, "duration": 0.02 * steps, "substeps": substeps}
        loop |= {"integrator": random.choice(["rk4", "euler"])}
        after = random.choice([0.0, 0.5])
        required = [{"metric": "error_max", "after": after, "max": 1.0}]
        yield {"name": f"random-{i}", "draws": 9, "seed": i, "loop": loop, "requirement": required, **study}


VEHICLE = {
    "name": "random-vehicle",
    "draws": 3,
    "loop": {"sample_time": 0.01, "duration": 1.0, "integrator": "euler"},
    "plant": {"kind": "uav", "vehicle": {"mass": {"uniform": [10.0, 12.0]}}},
    "reference": {"kind": "mission"},
    "wind": {"kind": "dryden", "speed": 4.0, "altitude": 10.0, "airspeed": 4.0},
    "sensor": {"kind": "noisy", "position_std": 0.01},
    "controller": {
        "kind": "dssc",
        "l0": 0.2,
        "rho": 1.5,
        "functions": {"kind": "square_root", **FUNCTIONS["square_root"]},
        "nominal": NOMINAL,
        "psi": {"rho": 0.5},
    },
}


@pytest.mark.parametrize("table", [*random_studies(), VEHICLE], ids=lambda table: table["name"])
def test_programs_agree(table):
    result = dj.run(dj.Study.from_table(table))
    study, lanes = result.study, (np.arange(table["draws"]),)
    assert np.isnan(result.dataset["failed_at"].values).any()
    assert_agrees(result, lanes, recompute(study, lanes))
    if len(study.loop.channels) == 1:
        first = {name: column[0] for name, column in lane_numbers(study, lanes).items()}
        alone = jax.jit(lane_of_study(study, axis_name=None), compiler_options=plain_options())(first, np.uint32(0))
        assert_agrees(result, (np.array([0]),), {name: np.asarray(value)[None] for name, value in alone.items()})


def assert_agrees(result, lanes, computed):
    found = agreement(result.study, result.dataset, lanes, computed)
    assert found.decided.all()
    assert (found.deviation <= found.allowed).all(), (found, computed)
