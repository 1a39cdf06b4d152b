"""The operating point about which a linear law acts: y_0, u_0 and s_0, at which the plant rests.

A linear law is a law of deviations. About an equilibrium other than 0, the reference's feedforward must act on
y_m - y_0, the feedback of signals on s - s_0, and u_0 holds the plant. A feedforward of the whole y_m would ask for a
command that the integral then has to take back.

In units, y stands for the unit of the plant's output, and u for the unit of its command.
"""

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import difference
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Signals

RESTING_OUTPUT = Quantity("y", "output y_0 at the operating point")
RESTING_COMMAND = Quantity("u", "command u_0 that holds the plant there")
RESTING_SIGNALS = Quantity("SI", "each measured signal s_0 there; absent: 0")


def deviations(signals: Signals, resting: Signals) -> Signals:
    """The deviations s - s_0 of measured signals from their values at rest; () at rest stands for zeros.

    Args:
        signals: The measured signals s.
        resting: Their values s_0 at rest; () if all are 0.
    """
    if not resting:
        return signals
    return tuple(difference(value, at_rest) for value, at_rest in zip(signals, resting, strict=True))


def require_resting(resting: Signals, count: int) -> None:
    """Require a value at rest for each of ``count`` measured signals, or none at all; raises ConfigError."""
    if resting and len(resting) != count:
        rule = f"must have a number for each of the {count} measured signals, got {len(resting)}"
        raise ConfigError("resting_signals", rule if count else "belongs to measured signals, and there are none")
