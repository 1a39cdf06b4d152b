"""State-dependent functions of DSSC: their values, the law that they synthesise, and helpers of their rows.

The rows, such as those of Table 2, are in :mod:`dssc_jax.models.controllers.gain_functions`. r = |sigma|^(1/2)
throughout. In units, y stands for the unit of the plant's output, and u for the unit of its command.
"""

from typing import NamedTuple, Protocol, TypeVar

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import log_defect
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar, State

ROOT_FLOOR = 1e-9  # [(y/s)^(1/2)]: the standard STA's k_o tau_av and tau_m vanish at sigma = 0

KAPPA_1 = Quantity("u (y/s)^(-1/2)", "proportional gain kappa_1 in Table 2's normalisation", above=0.0)
KAPPA_2 = Quantity("u/s", "integral gain kappa_2 in Table 2's normalisation: sgn times kappa_2/2", above=0.0)
DELTA = Quantity("(y/s)^(1/2)", "smoothing delta", above=0.0)
K_O = Quantity("y/(s^2 u)", "predictor gain k_o", above=0.0)
TAU_AV = Quantity("s", "averaging time constant tau_av", above=0.0)
TAU_M = Quantity("s", "predictor time constant tau_m", above=0.0)


class StateFunctions(NamedTuple):
    """Values of the functions at one sample: k_o [y/(s^2 u)], tau_av [s], tau_m [s]."""

    k_o: Scalar
    tau_av: Scalar
    tau_m: Scalar


class IntegratedLaw(NamedTuple):
    """The law u_av = phi_1 + integral of phi_2 that sliding synthesises, at one sample.

    (22) is u_av' = g sigma' + g sigma/tau_m with g = 1/(k_o tau_av). phi_1(sigma, e) is the integral of g over
    [0, sigma] at constant e. phi_2 is the rest, u_av' - phi_1'.

    Args:
        gain: phi_1/sigma, the mean of g over [0, sigma] [u s/y].
        rate: phi_2/phi_1 [1/s].
    """

    gain: Scalar
    rate: Scalar


class SuperTwisting(NamedTuple):
    """Gains kappa_1, kappa_2 of an STA in the normalisation of Table 2, and the smoothing delta [(y/s)^(1/2)]."""

    kappa1: Scalar
    kappa2: Scalar
    delta: Scalar


def super_twisting(functions: State) -> SuperTwisting:
    """Gains of the super-twisting algorithm (STA) that state-dependent functions approximate.

    Raises:
        ConfigError: The functions approximate no STA.
    """
    approximated = getattr(functions, "super_twisting", None)
    if approximated is None:
        raise ConfigError("", f"the functions '{type(functions).__name__}' approximate no super-twisting algorithm")
    return approximated()


def root_law(kappa: Scalar, r: Scalar, delta: Scalar, tau_m: Scalar) -> IntegratedLaw:
    """The law of g = kappa/(2 (r + delta)): phi_1 = kappa (r - delta ln(1 + r/delta)) sgn sigma.

    ``defect`` is (x - ln(1 + x))/x^2 at x = r/delta, so that phi_1/sigma = kappa defect/delta, without cancellation.

    Args:
        kappa: Gain kappa_1.
        r: |sigma|^(1/2).
        delta: Smoothing [(y/s)^(1/2)].
        tau_m: Predictor time constant at the sample [s].
    """
    defect = log_defect(r / delta)
    return IntegratedLaw(kappa / delta * defect, 0.5 * delta / (defect * (r + delta) * tau_m))


def factors(product: Scalar, tau_m: Scalar, k_o: Scalar | None, tau_av: Scalar | None) -> StateFunctions:
    """The functions from k_o tau_av and the given factor.

    Args:
        product: k_o tau_av.
        tau_m: Predictor time constant [s].
        k_o: Predictor gain [y/(s^2 u)]; None: it follows from tau_av.
        tau_av: Averaging time constant [s]; None: it follows from k_o.
    """
    if k_o is not None:
        return StateFunctions(k_o, product / k_o, tau_m)
    assert tau_av is not None  # held by require_one_factor, before tracing
    return StateFunctions(product / tau_av, tau_av, tau_m)


class Factored(Protocol):
    """Functions with a known product k_o tau_av; one factor is a parameter, and the other one is None."""

    @property
    def k_o(self) -> Scalar | None:
        """Predictor gain [y/(s^2 u)]; None: it follows from tau_av."""
        ...

    @property
    def tau_av(self) -> Scalar | None:
        """Averaging time constant [s]; None: it follows from k_o."""
        ...


F = TypeVar("F", bound=Factored)


def require_one_factor(gains: F) -> F:
    """The constants themselves, which must give exactly one of k_o and tau_av; raises ConfigError."""
    if (gains.k_o is None) == (gains.tau_av is None):
        given_factors = "neither" if gains.k_o is None else "both"
        raise ConfigError("", f"give one of k_o and tau_av, the other follows from their product; got {given_factors}")
    return gains
