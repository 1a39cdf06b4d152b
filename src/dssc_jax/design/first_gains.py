"""First gains for a plant of one's own, from a bandwidth and the sample time, in the plant's units.

The plant is linearised at its start, with the command that keeps it there if there is one, and sampled exactly, with
the command held. All three rules then work with numbers of that plant alone, whatever its units:

* PID: phase margin of 60 degrees at the bandwidth, integral action a decade below, a lead element split about it.
* LQG: y weighted with 1; the weight of u is that at which the regulator's loop crosses 1 at the bandwidth, and the
  noise of y that at which the filter's does so at four times that; integral action a decade below.
* Both have no integral action where the plant has a zero at rest.
* DSSC: its special case SSC, with constants. In sliding it synthesises a PI law of sigma, whose loop has a double pole
  at the bandwidth; e follows at a third of that.

A design of PID or LQG counts only if its sampled closed loop is stable. These gains begin a study: margins, draws and
tuning follow.

References:
    K. J. Astrom, R. M. Murray, Feedback Systems, 2nd ed. (2021), chapters 11 and 12.
    B. D. O. Anderson, J. B. Moore, Optimal Control: Linear Quadratic Methods (1990), sections 5.3 and 8.2.
"""

import math
from collections.abc import Callable
from enum import StrEnum
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.signals import PlantInput, Scalar
from dssc_jax.core.toml import TomlTable
from dssc_jax.models.controllers.lqg import SampledPlant, filter_gain, regulator_gain, sampled_system
from dssc_jax.study.fitting import medians
from dssc_jax.study.study import Study

PHASE_MARGIN = math.radians(60.0)
MOST_LEAD = math.radians(65.0)  # of one lead element
DECADE = 10.0
FILTER_RATIO = 4.0  # of the filter's bandwidth to the regulator's
SLOW_ERROR = 3.0  # of the bandwidth to l0
MOST_SHARE = 0.2  # of the bandwidth in pi/T_s
PLACES = 9  # bisections' decades of a weight on either side
DIGITS = 4
HALVINGS = 8
NEWTON_STEPS = 20
AT_REST = 1e-9  # share of the rate of change without a command that may be left


class FirstController(StrEnum):
    """The controllers for which there are first gains."""

    PID = "pid"
    LQG = "lqg"
    SSC = "ssc"


class LinearPlant(NamedTuple):
    """A plant of one channel at its start, sampled: x(k+1) = A x + B u, y = c x, and T_s [s]."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    sample_time: float

    def response(self, omega: float) -> complex:
        """From the held command to the sampled output at an angular frequency [rad/s]."""
        z = np.exp(1j * omega * self.sample_time)
        return complex(self.c @ np.linalg.solve(z * np.eye(len(self.a)) - self.a, self.b))


class FirstGains(NamedTuple):
    """A first design.

    Args:
        table: ``[controller]`` of a study.
        bandwidth: The frequency that it is made for [rad/s].
        radius: Largest modulus of the poles of the sampled closed loop, below 1; NaN for SSC, which switches.
    """

    table: TomlTable
    bandwidth: float
    radius: float


def plant_at_start(study: Study) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, b and c of a study's plant, linearised at its start with the median in place of each law.

    The command is the one that keeps the plant at its start; 0 where there is none.

    Raises:
        ConfigError: the plant has several channels.
    """
    loop = study.loop
    if len(loop.channels) > 1:
        raise ConfigError(f"{study.source}: plant.kind", "first gains are those of a plant with one command")
    params = medians(study.template).plant
    with arithmetic():
        start, unravel = ravel_pytree(jax.tree.map(lambda leaf: jnp.asarray(leaf, float), loop.plant.init(params)))
        inputs = (0.0,) * len(loop.inputs)

        def slope(x: jax.Array, u: Scalar) -> jax.Array:
            rate = loop.plant.derivative(params, unravel(x), PlantInput(u, 0.0, None, inputs), 0.0)
            return ravel_pytree(rate)[0]

        command = holding_command(slope, start)

        def output(x: jax.Array) -> Scalar:
            return loop.plant.measure(params, unravel(x), PlantInput(command, 0.0, None, inputs)).y

        a, b = jax.jacfwd(slope, argnums=(0, 1))(start, command)
        c = jax.grad(output)(start)
    return np.asarray(a, float), np.asarray(b, float), np.asarray(c, float)


def holding_command(slope: Callable[[jax.Array, Scalar], jax.Array], start: jax.Array) -> float:
    """The command with which a state stays where it is, by Newton's method; 0 where there is none.

    Args:
        slope: ``(x, u) -> x'``.
        start: The state x.
    """
    command = 0.0
    for _ in range(NEWTON_STEPS):
        rate = np.asarray(slope(start, command), float)
        effect = np.asarray(jax.jacfwd(slope, argnums=1)(start, command), float)
        size = float(effect @ effect)
        if not size > 0.0:
            return 0.0
        command -= float(effect @ rate) / size
    left = np.max(np.abs(np.asarray(slope(start, command), float)))
    moved = np.max(np.abs(np.asarray(slope(start, 0.0), float)))
    return command if left <= AT_REST * moved else 0.0


def first_gains(
    study: Study, kind: str = "pid", bandwidth: float | None = None, limit: float | None = None
) -> FirstGains:
    """First gains for a study's plant.

    Args:
        study: The study; what it says of its controller is not used.
        kind: ``pid``, ``lqg`` or ``ssc``.
        bandwidth: Frequency at which the loop gain is to cross 1 [rad/s]; None: a twentieth of pi/T_s, or the first
            half of it, and so on, for which there are gains.
        limit: Largest size of the command, in its unit; ``ssc`` needs it, the others respect it.

    Raises:
        ConfigError: the plant has several channels, or there are no such gains for it.
    """
    if kind not in list(FirstController):
        raise ConfigError("`kind`", f"must be one of {', '.join(FirstController)}, got '{kind}'")
    sample_time = study.loop.sample_time
    fastest = math.pi / sample_time
    if bandwidth is None:
        return fastest_of(study, kind, limit, 0.05 * fastest)
    chosen = bandwidth
    if not 0.0 < chosen <= MOST_SHARE * fastest:
        rule = f"must be > 0 and <= {MOST_SHARE:g} pi/T_s = {MOST_SHARE * fastest:.4g} rad/s, got {chosen:.4g}"
        raise ConfigError("`bandwidth`", f"{rule}; sample faster, or ask for less")
    if limit is not None and not limit > 0.0:
        raise ConfigError("`limit`", f"must be > 0, got {limit:g}")
    if kind == FirstController.LQG and study.loop.measures:
        rule = "measures other signals than y, and the first gains of LQG are those for y alone"
        raise ConfigError(f"{study.source}: sensor", f"{rule}; leave `measures` out, or state weights of your own")
    a, b, c = plant_at_start(study)
    discrete = sampled_system(a, b[:, None], sample_time)
    plant = LinearPlant(discrete.a, discrete.b, c, sample_time)
    if kind == FirstController.SSC:
        return ssc(study, a, b, c, chosen, limit)
    table, radius = pid(plant, chosen) if kind == FirstController.PID else lqg(plant, chosen)
    if not radius < 1.0:
        rule = f"gives at {chosen:.4g} rad/s a sampled loop that is not stable (largest pole {radius:.4g})"
        raise ConfigError("`bandwidth`", f"{rule}; ask for another one, or for 'lqg'")
    limits = {} if limit is None else {"low": -limit, "high": limit}
    return FirstGains(rounded(table | limits), chosen, radius)


def fastest_of(study: Study, kind: str, limit: float | None, start: float) -> FirstGains:
    """The first gains at the first of a bandwidth, its half, and so on, for which there are any; raises ConfigError."""
    refusal: ConfigError | None = None
    for half in range(HALVINGS):
        try:
            return first_gains(study, kind, start * 0.5**half, limit)
        except ConfigError as error:
            refusal = refusal or error
    assert refusal is not None  # raised at least once
    raise refusal


def pid(plant: LinearPlant, omega: float) -> tuple[TomlTable, float]:
    """The PID controller, and the largest pole of its loop; raises ConfigError."""
    at = plant.response(omega)
    corner = omega / DECADE if acts_at_rest(plant, omega) else 0.0
    needed = math.remainder(PHASE_MARGIN - math.pi - np.angle(at) + math.atan(corner / omega), 2.0 * math.pi)
    if needed > MOST_LEAD:
        rule = f"needs a phase lead of {math.degrees(needed):.0f} degrees at {omega:.4g} rad/s, and one element gives"
        remedy = f"{math.degrees(MOST_LEAD):.0f}; ask for less, or for 'lqg'"
        raise ConfigError("`bandwidth`", f"{rule} {remedy}")
    lead = max(needed, 0.0)
    ratio = math.sqrt((1.0 + math.sin(lead)) / (1.0 - math.sin(lead)))
    ahead = ratio / omega if lead else 0.0
    filtered = 1.0 / (ratio * omega) if lead else 0.0
    s = 1j * omega
    gain = 1.0 / abs((1.0 + corner / s) * (1.0 + ahead * s) / (1.0 + filtered * s) * at)
    if needed < -math.radians(90.0):
        rule = f"has at {omega:.4g} rad/s a phase of {math.degrees(float(np.angle(at))):.0f} degrees"
        remedy = "ask for a higher bandwidth, or for 'lqg'; where the gain is negative, turn the command's sign"
        raise ConfigError("plant", f"{rule}, with which this PID rule cannot cross there; {remedy}")
    k_i = gain * corner
    k_p = gain * (1.0 + corner * ahead) - k_i * filtered
    k_d = gain * ahead - k_p * filtered if lead else 0.0
    table: TomlTable = {"kind": "pid", "k_p": k_p} | ({"k_i": k_i} if k_i else {})
    if lead:
        table |= {"k_d": k_d, "filter": filtered}
    return table, pid_radius(plant, k_p, k_i, k_d, filtered)


def acts_at_rest(plant: LinearPlant, omega: float) -> bool:
    """Whether the plant has a gain at rest; if it has a zero there, an integral would grow without effect."""
    return abs(plant.response(1e-6 * omega)) > 1e-3 * abs(plant.response(omega))


def pid_radius(plant: LinearPlant, k_p: float, k_i: float, k_d: float, filtered: float) -> float:
    """Largest pole of the sampled loop, with the controller as it is sampled: states x, I, D and the last y."""
    n = len(plant.a)
    h = plant.sample_time
    y = np.append(plant.c, np.zeros(3))
    unit = np.eye(n + 3)[n + 2]
    derivative = (filtered * np.eye(n + 3)[n + 1] - k_d * (y - unit)) / (filtered + h)
    u = -k_p * y + np.eye(n + 3)[n] + derivative
    matrix = np.zeros((n + 3, n + 3))
    matrix[:n, :n] = plant.a
    matrix[:n] += np.outer(plant.b, u)
    matrix[n] = np.eye(n + 3)[n] - h * k_i * y if k_i else 0.0
    matrix[n + 1] = derivative
    matrix[n + 2] = y
    return spectral_radius(matrix)


def spectral_radius(matrix: np.ndarray) -> float:
    """Largest modulus of a matrix's eigenvalues."""
    return float(np.max(np.abs(np.linalg.eigvals(matrix))))


def lqg(plant: LinearPlant, omega: float) -> tuple[TomlTable, float]:
    """The LQG controller of y alone, and the largest pole of its loop; raises ConfigError."""
    system = SampledPlant(plant.a, plant.b, plant.b[:, None])
    q = np.outer(plant.c, plant.c)
    size = abs(plant.response(omega))
    noise = np.outer(plant.b, plant.b)
    z = plant.sample_time
    faster = min(FILTER_RATIO * omega, 0.5 * math.pi / z)

    def regulated(weight: float) -> float:
        gains = regulator_gain(system.a, system.b[:, None], q, weight)
        return loop_size(plant.a, plant.b, gains, omega, z)

    def filtered(deviation: float) -> float:
        correction = filter_gain(system.a, plant.c[None, :], noise, deviation**2 * np.eye(1))
        return loop_size(plant.a, plant.a @ correction[:, 0], plant.c, faster, z)

    weight = crossing(regulated, size**2)
    deviation = crossing(filtered, abs(plant.response(faster)))
    integral = (omega / DECADE) ** 2 if acts_at_rest(plant, omega) else 0.0
    table: TomlTable = {"kind": "lqg", "output_weight": 1.0, "command_weight": weight, "integral_weight": integral}
    table |= {"signal_std": [deviation], "disturbance_std": [1.0]}
    return table, lqg_radius(plant, weight, integral, deviation)


def lqg_radius(plant: LinearPlant, weight: float, integral: float, deviation: float) -> float:
    """Largest pole: by the separation of regulator and filter, the larger of theirs."""
    n = len(plant.a)
    matrix, column, q = plant.a, plant.b, np.outer(plant.c, plant.c)
    if integral:
        matrix = np.block([[matrix, np.zeros((n, 1))], [plant.sample_time * plant.c[None, :], np.ones((1, 1))]])
        column = np.append(column, 0.0)
        q = np.block([[q, np.zeros((n, 1))], [np.zeros((1, n)), integral * np.ones((1, 1))]])
    gains = regulator_gain(matrix, column[:, None], q, weight)
    correction = filter_gain(plant.a, plant.c[None, :], np.outer(plant.b, plant.b), deviation**2 * np.eye(1))
    regulated = spectral_radius(matrix - np.outer(column, gains))
    return max(regulated, spectral_radius(plant.a - plant.a @ np.outer(correction[:, 0], plant.c)))


def loop_size(a: np.ndarray, column: np.ndarray, row: np.ndarray, omega: float, sample_time: float) -> float:
    """|row (z - A)^-1 column| at an angular frequency."""
    z = np.exp(1j * omega * sample_time)
    return float(abs(row @ np.linalg.solve(z * np.eye(len(a)) - a, column)))


def crossing(size: Callable[[float], float], guess: float) -> float:
    """The positive number at which a falling function is 1, by bisection of its logarithm; raises ConfigError."""
    low, high = guess * 10.0**-PLACES, guess * 10.0**PLACES
    if not size(low) > 1.0 > size(high):
        raise ConfigError("`bandwidth`", "is out of reach of every weight for this plant; ask for another one")
    for _ in range(80):
        middle = math.sqrt(low * high)
        if size(middle) > 1.0:
            low = middle
        else:
            high = middle
    return math.sqrt(low * high)


def ssc(study: Study, a: np.ndarray, b: np.ndarray, c: np.ndarray, omega: float, limit: float | None) -> FirstGains:
    """SSC, whose loop in sliding is sigma'' + k_p K_P sigma' + k_p K_I sigma; raises ConfigError."""
    if abs(c @ b) > 1e-9 * (np.abs(c) @ np.abs(b)) or not c @ a @ b > 0.0:
        rule = "is not of relative degree two with k_p > 0 from command to output, as SSC needs"
        raise ConfigError(f"{study.source}: plant", f"{rule}; ask for 'pid' or 'lqg'")
    if limit is None:
        raise ConfigError("`limit`", "is required for 'ssc': rho is the largest command that it can average")
    gain = float(c @ a @ b)
    averaging = max(2.0 * study.loop.sample_time, 0.1 / omega)
    functions = {"kind": "constant", "k_o": gain / (2.0 * omega * averaging), "tau_av": averaging, "tau_m": 2.0 / omega}
    table = {"kind": "ssc", "l0": omega / SLOW_ERROR, "rho": limit, "functions": rounded(functions)}
    return FirstGains(rounded(table), omega, math.nan)


def rounded(table: TomlTable) -> TomlTable:
    """A table whose numbers have four digits."""
    found: TomlTable = {}
    for name, value in table.items():
        if isinstance(value, list):
            found[name] = [float(f"{item:.{DIGITS}g}") for item in value]
        else:
            found[name] = float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value
    return found
