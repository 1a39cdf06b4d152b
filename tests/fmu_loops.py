"""Loops with the FMUs of tests/fmus.py, and the same loops of the package's own models."""

import numpy as np

import dssc_jax as dj
from dssc_jax.engine.batching import Engine, evaluate

DRAWS = 24
EQUAL = 1e-12
"""Relative difference of a loop with an FMU from that without: a few roundings, for products are contracted or not."""

NAMES = {
    "plant.parameters.body_gain": "plant.k_p",
    "plant.parameters.drag": "plant.a_p",
    "plant.parameters.x0": "plant.initial.0",
    "controller.parameters.k_p": "controller.k_p",
}
LAWS = {"gain": {"uniform": [0.8, 1.2]}, "drag": {"uniform": [0.5, 1.5]}, "x0": {"uniform": [0.5, 1.0]}}
K_P = {"uniform": [4.0, 8.0]}
OWN_PLANT = {"kind": "normal_form", "k_p": LAWS["gain"], "a_p": LAWS["drag"], "initial": [LAWS["x0"], 0.0]}
OWN_PID = {"kind": "pid", "k_p": K_P, "k_i": 2.0, "k_d": 3.0, "filter": 0.02}
METRICS = ("error_rms", "error_max", "command_max", "command_tv")


def plant_of(mass, **changes):
    parameters = {"body_gain": LAWS["gain"], "drag": LAWS["drag"], "x0": LAWS["x0"]}
    table = {"kind": "fmu", "file": str(mass), "command": "u", "y": "x", "y_dot": "v", "outputs": {"power": "power"}}
    return {**table, "sha256": dj.allow_native(mass).sha256, "parameters": parameters, **changes}


def controller_of(pid, **changes):
    parameters = {"k_p": K_P, "k_i": 2.0, "k_d": 3.0, "filter": 0.02}
    table = {"kind": "fmu", "file": str(pid), "command": "command", "inputs": {"y": "y", "y_ref": "r"}}
    return {**table, "sha256": dj.allow_native(pid).sha256, "parameters": parameters, **changes}


def loop_of(plant, controller, **changes):
    table = {
        "name": "fmu",
        "seed": 3,
        "draws": DRAWS,
        "loop": {"duration": 3.0, "sample_time": 0.01},
        "plant": plant,
        "controller": controller,
        "reference": {"kind": "sine", "amplitude": 1.0, "period": 4.0},
        "disturbance": {"kind": "step", "value": 0.5, "at": 2.0},
        "metrics": {"names": list(METRICS)},
        "requirement": [{"metric": "error_rms", "after": 1.0, "max": 0.55}],
    }
    return dj.Study.from_table({**table, **changes})


def results(study, values, order=None, lanes=DRAWS, **options):
    """Metrics and outcome of each draw, computed in some order."""
    order = np.arange(DRAWS) if order is None else order
    engine = Engine(study, lanes, **options)
    found = evaluate(engine, {name: column[order] for name, column in values.items()}, order)
    back = np.argsort(order)
    return {name: column[back] for name, column in found.items()}


def own_results(plant, controller, values, **changes):
    """The same draws with the package's own models."""
    study = loop_of(plant, controller, **changes)
    return results(study, {NAMES[name]: column for name, column in values.items() if NAMES[name] in study.laws})


def assert_same(found, expected):
    for name in METRICS:
        np.testing.assert_allclose(found[name], expected[name], rtol=EQUAL)
    assert np.array_equal(found["outcome"], expected["outcome"])


def assert_same_verdicts(found, expected):
    assert_same(found, expected)
    assert len(set(found["outcome"].tolist())) > 1  # some draws fail, others do not
