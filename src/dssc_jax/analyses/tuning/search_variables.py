"""Variables of a search: tuned numbers mapped to unbounded coordinates, and the design that Theorem 1 makes of them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import expit, logit

from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.signals import Scalar
from dssc_jax.design import Bounds, Certificate, Free, Parameters, check, design, loop_bounds
from dssc_jax.design.ends import Ends, ends_of
from dssc_jax.design.small_gain import small_gain
from dssc_jax.design.table1 import inequalities
from dssc_jax.study import Study

Numbers: TypeAlias = Mapping[str, Scalar]
"""Tuned numbers or the loop's numbers by name, traced or not."""


def identity(tuned: Numbers) -> Numbers:
    """Return the tuned numbers unchanged as the loop's numbers: the ``expand`` of a search without a design."""
    return dict(tuned)


@dataclass(frozen=True, eq=False)
class SearchCoordinates:
    """The map between tuned numbers in intervals and unbounded coordinates z of a search.

    A tuned number is low (high/low)^s(z) with s(z) = 1/(1 + e^-z). It tends to ``low`` as z tends to minus infinity,
    and to ``high`` as z tends to infinity.

    Args:
        extents: Lowest and highest value of each tuned number, 0 < low < high.
        start: Values at the start of the search, inside the intervals.
        expand: (tuned numbers) -> the loop's numbers that follow from them, by dotted name.
    """

    extents: dict[str, tuple[float, float]]
    start: dict[str, float]
    expand: Callable[[Numbers], Numbers] = identity

    @property
    def names(self) -> list[str]:
        """Names of the tuned numbers, in the order of the coordinates."""
        return list(self.extents)

    @property
    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Natural logarithms of the lower and of the upper ends of the intervals, shape (n,) each."""
        low, high = np.log(np.array(list(self.extents.values()))).T
        return low, high

    @property
    def origin(self) -> np.ndarray:
        """Coordinates of the start, shape (n,)."""
        low, high = self.ends
        start = np.log([self.start[name] for name in self.names])
        return logit((start - low) / (high - low))

    def tuned(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """The tuned numbers at coordinates of shape (..., n), by name, shape (...) each."""
        low, high = self.ends
        values = np.exp(low + (high - low) * expit(z))
        return {name: values[..., i] for i, name in enumerate(self.names)}

    def numbers(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """The loop's numbers at points of shape (m, n), by dotted name; shape (m,) each."""
        with jax.enable_x64(True):
            return on_host(values_at_points(self.traced, jnp.asarray(z)))

    def slopes(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """Derivatives of the loop's numbers by the coordinates, at points of shape (m, n); shape (m, n) each."""
        with jax.enable_x64(True):
            return on_host(slopes_at_points(self.traced, jnp.asarray(z)))

    def traced(self, z: jax.Array) -> dict[str, jax.Array]:
        """The loop's numbers at one traced point of shape (n,), by dotted name."""
        low, high = self.ends
        values = jnp.exp(low + (high - low) * jax.nn.sigmoid(z))
        numbers = self.expand({name: values[i] for i, name in enumerate(self.names)})
        return {name: jnp.asarray(value) for name, value in numbers.items()}


def on_host(arrays: Mapping[str, jax.Array]) -> dict[str, np.ndarray]:
    """JAX arrays copied to NumPy arrays, by name."""
    return {name: np.asarray(array) for name, array in arrays.items()}


@partial(jax.jit, static_argnums=0)
def values_at_points(function: Callable[[jax.Array], dict[str, jax.Array]], z: jax.Array) -> dict[str, jax.Array]:
    """Values of a function at points z of shape (m, n), by name, shape (m,) each."""
    return jax.vmap(function)(z)


@partial(jax.jit, static_argnums=0)
def slopes_at_points(function: Callable[[jax.Array], dict[str, jax.Array]], z: jax.Array) -> dict[str, jax.Array]:
    """Derivatives of a function at points z of shape (m, n), by name, shape (m, n) each."""
    return jax.vmap(jax.jacfwd(function))(z)


FREE_PREFIX = "free."  # of a free parameter's name among the tuned numbers
REQUIRED_PARAMETERS = tuple(name for name in Free._fields if name not in Free._field_defaults)


def name_in_study(name: str) -> str:
    """The dotted name in a study of a parameter of Table 1; that of ``eps`` is ``controller.functions.epsilon``."""
    if name == "l0":
        return "controller.l0"
    return f"controller.functions.{'epsilon' if name == 'eps' else name}"


SMALL_GAIN = "small gain"  # name of the small-gain condition among the inequalities
SLACK = "slack of "  # prefix of an inequality's name among the limits
PARAMETER_OF_NUMBER = {name_in_study(name): name for name in Parameters._fields}
"""The parameter of Table 1 by the dotted name of the loop's number; the free parameters determine all of them."""


@dataclass
class Theorem:
    """Theorem 1 for the loop of a study: the design from free parameters, and the check of any design.

    Args:
        study: The study, whose controller has the functions of Table 1.
        fixed: Values of the free parameters that are not varied.
        option: The setting that requires the theorem, for messages.

    Raises:
        ConfigError: The theorem does not apply to this loop, or its bounds are not known beforehand.
    """

    study: Study
    fixed: Mapping[str, float]
    option: str = "tune.certified"
    parameters: Parameters = field(init=False)
    ends: Ends = field(init=False)

    def __post_init__(self) -> None:
        """Find the parameters of Table 1 and check that the loop's bounds are known."""
        nominal = getattr(self.study.template.controller[0], "nominal", None)
        if nominal is not None and nominal.predictor_term:
            rule = "the bound of u_n then holds 1/tau_m, hence the parameters that follow from it; set it to false"
            raise ConfigError("controller.nominal.predictor_term", f"cannot be certified while tuning: {rule}")
        try:
            self.parameters, bounds = loop_bounds.design_of(self.study)
        except loop_bounds.NotCovered as error:
            raise ConfigError(self.option, f"Theorem 1 does not speak of this loop: {error}") from None
        try:
            bounds.prepare()
        except ConfigError as error:
            raise ConfigError(self.option, f"the loop's bounds are no bounds: {error}") from None
        self.ends = ends_of(self.study)

    def free_parameters(self, tuned: Numbers) -> Free:
        """The free parameters of Theorem 1: each has its tuned value, or else its fixed value, or else its default."""
        values: dict[str, Scalar] = dict(self.fixed)
        for name, value in tuned.items():
            if name.startswith(FREE_PREFIX):
                values[name.removeprefix(FREE_PREFIX)] = value
        return Free(**values)

    def expand(self, tuned: Numbers) -> dict[str, Scalar]:
        """The loop's numbers: the design that follows from the free parameters, and the other tuned numbers."""
        free = self.free_parameters(tuned)
        error_pole = {name_in_study("l0"): free.l0}  # the bound of the nominal control depends on it
        _, bounds = self.parameters_and_bounds(error_pole)
        designed = design(bounds, free)
        other_numbers = {name: value for name, value in tuned.items() if not name.startswith(FREE_PREFIX)}
        return other_numbers | {name_in_study(name): value for name, value in designed._asdict().items()}

    def parameters_and_bounds(self, numbers: Numbers) -> tuple[Parameters, Bounds]:
        """Parameters of Table 1 and bounds of the loop, with some of the loop's numbers changed.

        Args:
            numbers: The changed numbers by dotted name; all others are the study's. Numbers that are no parameters of
                Table 1 are ignored.
        """
        changes = {}
        for loop_name, name in PARAMETER_OF_NUMBER.items():
            if loop_name in numbers:
                changes[name] = numbers[loop_name]
        parameters = self.parameters._replace(**changes)
        return parameters, loop_bounds.bounds_of(self.study.loop, self.ends, parameters)

    def certificate(self, numbers: Mapping[str, float]) -> Certificate:
        """Check the inequalities of Theorem 1, without tolerance, for the loop with some of its numbers changed."""
        plain_numbers = {name: float(value) for name, value in numbers.items()}
        parameters, bounds = self.parameters_and_bounds(plain_numbers)
        return check(parameters, bounds)

    def excess(self, numbers: Numbers, slack: float) -> dict[str, jax.Array]:
        """How far each inequality ``value > bound`` misses ``value >= (1 + slack) bound``, over |value| + |bound|.

        Args:
            numbers: The loop's numbers, traced.
            slack: The relative slack.

        Returns:
            The excess of each inequality by name: not positive if the slack is kept; 1 if the bound is not finite.
        """
        parameters, bounds = self.parameters_and_bounds(numbers)
        rows = [(row.name, row.value, row.bound) for row in inequalities(parameters, bounds)]
        rows.append((SMALL_GAIN, parameters.phi_b, small_gain(parameters, bounds).derived))
        excess = {}
        for name, value, bound in rows:
            is_finite = jnp.isfinite(bound)
            limit = jnp.where(is_finite, bound, 0.0)  # a finite number, so that its derivative is no NaN
            shortfall = ((1.0 + slack) * limit - value) / (jnp.abs(limit) + jnp.abs(value))
            excess[SLACK + name] = jnp.where(is_finite, shortfall, 1.0)
        return excess


def split_parameters(
    free: Mapping[str, tuple[float, float] | float],
) -> tuple[dict[str, tuple[float, float]], dict[str, float]]:
    """Split the free parameters of ``[tune.free]`` into those that are varied and those that are fixed.

    Args:
        free: [low, high] of each varied parameter, and the value of each fixed one, by name.

    Returns:
        The interval of each varied parameter, by its name with :data:`FREE_PREFIX` before it, and the value of each
        fixed parameter, by its name.

    Raises:
        ConfigError: A parameter is missing or unknown, or none is varied.
    """
    for name in free:
        if name not in Free._fields:
            raise ConfigError(f"tune.free.{name}", f"unknown name; {nearest(name, Free._fields)}")
    for name in REQUIRED_PARAMETERS:
        if name not in free:
            raise ConfigError(f"tune.free.{name}", "is required and missing: [low, high] to vary it, or a number")
    intervals = {}
    fixed = {}
    for name, value in free.items():
        if isinstance(value, tuple):
            intervals[FREE_PREFIX + name] = value
        else:
            fixed[name] = value
    if not intervals:
        raise ConfigError("tune.free", "varies nothing; give [low, high] for one at least")
    return intervals, fixed
