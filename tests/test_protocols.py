"""One parametrised test of the contract over every registered model: a new row inherits it."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import quantities_of
from dssc_jax.core.registry import single
from dssc_jax.core.setting import LoopSetting, NominalPlant
from dssc_jax.core.signals import Measurement, PlantInput, ReferencePoint
from dssc_jax.models.actuators import UNMODELLED
from dssc_jax.models.controllers import CONTROLLERS
from dssc_jax.models.controllers.gain_functions import GAIN_FUNCTIONS
from dssc_jax.models.controllers.modulation import MODULATIONS
from dssc_jax.models.differentiators import DIFFERENTIATORS
from dssc_jax.models.disturbances import DISTURBANCES
from dssc_jax.models.plants import PLANTS
from dssc_jax.models.references import REFERENCES, TRAJECTORIES
from dssc_jax.models.sensors import SENSORS
from dssc_jax.models.wind import WINDS
from dssc_jax.study.components import parse_component
from tests.contracts import assert_contract

REGISTRIES = {
    "controller": CONTROLLERS,
    "functions": GAIN_FUNCTIONS,
    "rho": MODULATIONS,
    "plant": PLANTS,
    "unmodelled": UNMODELLED,
    "sensor": SENSORS,
    "differentiator": DIFFERENTIATORS,
    "disturbance": DISTURBANCES,
    "reference": REFERENCES,
    "trajectory": TRAJECTORIES,
    "wind": WINDS,
}
FUNCTIONS = {kind: entry.example for kind, entry in GAIN_FUNCTIONS.items()}
NORM_BOUND = {"kind": "norm_bound", **MODULATIONS["norm_bound"].example}
NOMINAL = {"a": 1.0, "k": 1.0}


def example(registry, kind):
    """The table of a row's example."""
    return {"kind": kind, **registry[kind].example}


def examples(registry):
    """The table of each row's example; a row whose model a file defines has none, see tests/models/controllers."""
    return [example(registry, kind) for kind, entry in registry.items() if entry.loaded is None]


def controller_examples():
    """The table of each controller's example, with a nominal control where it takes one."""
    for table in examples(CONTROLLERS):
        fields = CONTROLLERS[table["kind"]].default_member.gains._fields
        yield table | ({"nominal": NOMINAL} if "nominal" in fields else {})


def has_free_functions(table):
    """Whether the state-dependent functions of a controller are the study's choice."""
    return "functions" in table and "functions" not in CONTROLLERS[table["kind"]].base


def variants(table):
    """Tables like one with state-dependent functions: each kind of functions, of modulation and of start."""
    for kind, numbers in FUNCTIONS.items():
        functions = {"kind": kind, **numbers}
        yield table | {"functions": functions}
        yield table | {"functions": functions, "rho": NORM_BOUND, "predictor_start": "matched"}
    yield table | {"predictor_start": "zero"}


def controller_cases():
    for table in controller_examples():
        entry = CONTROLLERS[table["kind"]]
        tables = list(variants(table)) if has_free_functions(table) else [table]
        for option in entry.members:
            for index, case in enumerate(tables):
                chosen = {entry.option: option.value} if entry.option else {}
                yield pytest.param(case | chosen, id=f"{case['kind']}-{option}-{index}")


@pytest.mark.parametrize("slot", REGISTRIES)
def test_every_row_has_an_example(slot):
    """Its table is complete; only a model without parameters, or with defaults for all, has an empty one."""
    for table in examples(REGISTRIES[slot]):
        parse_component(table, REGISTRIES[slot], slot)


def test_a_row_without_an_example_is_found():
    planted = {"sine": single(REFERENCES["sine"].default_member, "a row without an example")}
    with pytest.raises(ConfigError, match="amplitude"):
        parse_component(example(planted, "sine"), planted, "reference")


def typed(tree):
    return jax.tree.map(jnp.asarray, tree)


SETTING = LoopSetting(
    0.01,
    (),
    NominalPlant(
        a=np.array([[0.0, 1.0], [0.0, -1.0]]),
        command=np.array([0.0, 1.0]),
        disturbances=np.array([[0.0], [1.0]]),
        output=np.array([1.0, 0.0]),
        signals=np.zeros((0, 2)),
        feedthrough=np.zeros(0),
        inputs=("disturbance",),
    ),
)
"""A double integrator with friction, of which y is measured."""


def fitted_component(table):
    """A controller with its gains, fitted to a nominal plant where it is."""
    component = parse_component(table, CONTROLLERS, "controller")
    fit = component.model.fit
    return component if fit is None else replace(component, params=fit(component.params, SETTING))


@pytest.mark.parametrize("table", list(controller_cases()))
def test_controller(table):
    component = fitted_component(table)
    controller, gains = component.model, component.params
    reference = ReferencePoint(0.1, -0.2, 0.3)

    def two_steps(y, y_dot):
        state = controller.init(gains, Measurement(y, y_dot), reference)
        state, command, info = controller.step(gains, state, Measurement(y, y_dot), reference, 0.01)
        state, command, info = controller.step(gains, state, Measurement(0.9 * y, y_dot), reference, 0.01)
        return state, command, info

    first = controller.init(gains, Measurement(1.0, -0.5), reference)
    info = assert_contract(two_steps, first)[-1]
    assert type(info) is controller.info
    assert set(quantities_of(controller.info)) == set(info._fields)


@pytest.mark.parametrize("table", list(controller_cases()))
@pytest.mark.parametrize("at", [(0.1, -0.2), (0.1, 0.3), (0.6, -0.45), (1.0, 0.0)])
def test_gradients_are_finite(table, at):
    """With respect to the measurement and to every gain; (0.1, -0.2) is sigma = 0 and e = 0 exactly."""
    component = fitted_component(table)
    controller = component.model
    reference = ReferencePoint(0.1, -0.2, 0.3)
    numbers, tree = jax.tree.flatten(component.params)

    def command(numbers, y, y_dot):
        gains = tree.unflatten(numbers)
        state = controller.init(gains, Measurement(y, y_dot), reference)
        return controller.step(gains, state, Measurement(y, y_dot), reference, 0.01)[1].total

    floats = [float(x) for x in numbers]
    for leaf in jax.tree.leaves(jax.grad(command, argnums=(0, 1, 2))(floats, *at)):
        assert jnp.isfinite(leaf)


ZERO_DYNAMICS = {"a": [2.0, 3.0], "c": [0.1, 0.2]}
PLANT_TABLES = [
    *examples(PLANTS),
    example(PLANTS, "normal_form") | {"zero_dynamics": ZERO_DYNAMICS, "initial": [1.0, 2.0, 0.3]},
]


@pytest.mark.parametrize("table", PLANT_TABLES)
def test_plant(table):
    component = parse_component(table, PLANTS, "plant")
    plant, params = component.model, component.params
    state = typed(plant.init(params))
    slope = plant.derivative(params, state, PlantInput(0.5, 0.1), 0.0)
    assert jax.tree.structure(state) == jax.tree.structure(slope)
    assert set(plant.velocities) <= set(state._fields)
    assert isinstance(plant.measure(params, state, PlantInput(0.5, 0.1)), Measurement)
    assert float(plant.input_gain(params)) == 1.0


@pytest.mark.parametrize(
    ("registry", "table"),
    [
        (REFERENCES, {"kind": "zero"}),
        (REFERENCES, {"kind": "sine", "amplitude": 2.0, "period": 7.0, "phase": 0.3, "offset": 1.0}),
        *((REFERENCES, {"kind": "mission", "axis": axis}) for axis in ("x", "y", "z", "psi")),
    ],
)
def test_reference_derivatives(registry, table):
    """y_m' and y_m'' are the derivatives of y_m."""
    component = parse_component(table, registry, "reference")

    def y(t):
        return jnp.asarray(component.model.at(component.params, t).y, dtype=float)

    for t in (0.0, 1.7, 33.0):
        point = component.model.at(component.params, t)
        assert float(jax.grad(y)(t)) == pytest.approx(float(point.y_dot), abs=1e-12)
        assert float(jax.grad(jax.grad(y))(t)) == pytest.approx(float(point.y_ddot), abs=1e-12)


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        ({"kind": "none"}, 0.0),
        ({"kind": "constant", "value": 0.4}, 0.4),
        ({"kind": "sine", "amplitude": 2.0, "period": 4.0}, 2.0 * np.sin(np.pi / 2 * 3.01)),
        ({"kind": "step", "value": 0.8, "at": 1.0}, 0.8),
        ({"kind": "step", "value": 0.8, "at": 3.0075}, 0.8 * 0.25),
        ({"kind": "step", "value": 0.8, "at": 5.0}, 0.0),
        ({"kind": "spline", "knots": [0.6, -0.3], "interval": 1.5, "at": 1.51}, 4 * -0.3 / 6 + 0.6 / 6),
        ({"kind": "spline", "knots": [0.6], "interval": 0.5}, 0.0),
    ],
)
def test_disturbance_values(table, expected):
    component = parse_component(table, DISTURBANCES, "disturbance")
    model, params, key = component.model, component.params, jax.random.key(0)
    state = model.step(params, model.init(params, key), key, 3.0, 0.01)
    assert float(model.value(params, state, Measurement(1.0, 2.0), 0.5, 3.01)) == pytest.approx(expected, abs=1e-14)


def test_partition_attains_its_bounds():
    table = {"kind": "partition", "k_d1": 0.1, "k_d2": 0.2, "k_d3": 0.3, "k_d4": 0.4, "k_d5": 0.2}
    table |= {"alpha_d2": 0.05, "alpha_d3": 0.07, "period": 2 * np.pi}
    component = parse_component(table, DISTURBANCES, "disturbance")

    def d(y, y_dot, sigma, t):
        return component.model.value(component.params, (), Measurement(y, y_dot), sigma, t)

    ts = jnp.linspace(0.0, 2 * np.pi, 2001)
    by_y = jax.vmap(jax.grad(d), (None, None, None, 0))(1.5, -0.7, 0.0, ts)
    by_t = jax.vmap(jax.grad(d, 3), (None, None, None, 0))(1.5, -0.7, 0.0, ts)
    assert float(jnp.abs(by_y).max()) == pytest.approx(0.4)  # k_d4
    assert float(jnp.abs(by_t).max()) == pytest.approx(0.2 * 1.5 + 0.05 + 0.07)  # k_d5 |y| + alpha_d2 + alpha_d3
    assert float(jax.grad(d, 2)(1.5, -0.7, 1.0, 0.0)) == pytest.approx(0.1 * 1.5 + 0.2 * 0.7 + 0.3)  # alpha_d1


def test_filtered_noise_has_the_stated_law_at_any_step():
    for dt in (0.001, 0.02, 0.5):
        component = parse_component({"kind": "filtered_noise", "std": 0.7, "correlation_time": 0.4}, DISTURBANCES, "d")
        model, params = component.model, component.params

        def path(key, model=model, params=params, dt=dt):
            keys = jax.random.split(key, 3)
            first = model.init(params, keys[0])
            second = model.step(params, first, keys[1], 0.0, dt)
            return first, second

        first, second = jax.vmap(path)(jax.random.split(jax.random.key(1), 100_000))
        assert float(jnp.std(second)) == pytest.approx(0.7, rel=0.01)
        assert float(jnp.corrcoef(first, second)[0, 1]) == pytest.approx(np.exp(-dt / 0.4), abs=0.01)


@pytest.mark.parametrize("kind", UNMODELLED)
def test_unmodelled(kind):
    component = parse_component(example(UNMODELLED, kind), UNMODELLED, "unmodelled")
    model, params = component.model, component.params

    key = jax.random.key(0)

    def two_steps(first, second):
        state = model.init(params)
        for command in (first, second):
            state = model.step(params, model.sample(params, state, command, key, 0.01), command, 0.01)
        return state, model.output(params, state, second)

    assert_contract(two_steps, model.init(params))


@pytest.mark.parametrize("order", [1, 2])
def test_lag_is_exact(order):
    """Against the step response of 1/(mu s + 1)^order, in steps far longer than mu too."""
    component = parse_component({"kind": "lag", "order": order, "mu": 0.03}, UNMODELLED, "unmodelled")
    model, params = component.model, component.params
    for dt in (1e-3, 0.05, 1.0):
        state, t = model.init(params), 0.0
        for _ in range(5):
            state, t = model.step(params, state, 2.0, dt), t + dt
            exact = 2.0 * (1 - np.exp(-t / 0.03) * (1 + (t / 0.03 if order == 2 else 0.0)))
            assert float(model.output(params, state, 2.0)) == pytest.approx(exact, abs=1e-14)


@pytest.mark.parametrize("delay", [0.0, 2.0, 2.25])
def test_delay_is_linear_between_samples(delay):
    """A delay of n + f samples is (1 - f) of the command n samples ago and f of the one before."""
    component = parse_component({"kind": "delay", "samples": delay, "memory": 4}, UNMODELLED, "unmodelled")
    model, params = component.model, component.params
    state, seen = model.init(params), []
    for command in range(1, 8):
        state = model.sample(params, state, float(command), jax.random.key(0), 0.1)
        seen.append(float(model.output(params, state, float(command))))
    assert seen[3:] == pytest.approx([command - delay for command in range(4, 8)], abs=1e-14)


def test_a_delay_must_fit_the_memory():
    with pytest.raises(ConfigError, match="must be <= memory = 4, got up to 5"):
        parse_component({"kind": "delay", "samples": {"uniform": [0, 5]}, "memory": 4}, UNMODELLED, "unmodelled")
    with pytest.raises(ConfigError, match="whole number"):
        parse_component({"kind": "delay", "samples": 1.0, "memory": 4.5}, UNMODELLED, "unmodelled")
