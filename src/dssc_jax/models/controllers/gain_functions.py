"""The state-dependent functions k_o, tau_av, tau_m of (sigma, e): the rows of Table 2, Section V and Table 1.

Each row is a NamedTuple of its constants, with these methods and attributes:

* ``at(sigma, e, l0)`` gives the values of the functions. In sliding only the product k_o tau_av and tau_m matter (22).
  A row that defines only the product takes one of k_o and tau_av, and the other follows.
* ``law(sigma, e, at)`` gives the control law that (22) synthesises, integrated.
* ``super_twisting()``, if the row has it, gives the STA that the row approximates.
* ``sampled_form`` is the form in which DSSC is sampled unless the study says otherwise.
* ``tunable`` names the two constants that a comparison tunes.
* ``finite_slope`` tells whether phi_1 has a finite slope at 0.

r = |sigma|^(1/2) throughout.

In units, y stands for the unit of the plant's output, and u for the unit of its command.
"""

from typing import Annotated, NamedTuple

from dssc_jax.core.numerics import log_defect, root_abs, sign
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Discretisation, Registry, single
from dssc_jax.core.signals import Scalar
from dssc_jax.core.smoothness import SMOOTH, SWITCHES, not_smooth, piecewise
from dssc_jax.models.controllers.state_functions import (
    DELTA,
    K_O,
    KAPPA_1,
    KAPPA_2,
    ROOT_FLOOR,
    TAU_AV,
    TAU_M,
    IntegratedLaw,
    StateFunctions,
    SuperTwisting,
    factors,
    require_one_factor,
    root_law,
)


class Constant(NamedTuple):
    """Constant k_o, tau_av and tau_m: the original SSC, which synthesises PI control.

    Its gains are K_P = 1/(k_o tau_av) and K_I = K_P/tau_m.
    """

    k_o: Annotated[Scalar, K_O]
    tau_av: Annotated[Scalar, TAU_AV]
    tau_m: Annotated[Scalar, TAU_M]

    sampled_form = Discretisation.CONSERVATIVE
    tunable = ("k_o", "tau_m")
    finite_slope = True
    smooth = SMOOTH

    def at(self, sigma: Scalar, e: Scalar, l0: Scalar) -> StateFunctions:
        """The constants themselves, in every state (Table 2, row 1).

        sigma, e and l0 are arguments of every row; constants do not depend on them.
        """
        return StateFunctions(self.k_o, self.tau_av, self.tau_m)

    def law(self, sigma: Scalar, e: Scalar, at: StateFunctions) -> IntegratedLaw:
        """PI: phi_1 = sigma/(k_o tau_av), phi_2 = phi_1/tau_m.

        The gain phi_1/sigma and the rate phi_2/phi_1 are constant.
        """
        return IntegratedLaw(1.0 / (at.k_o * at.tau_av), 1.0 / at.tau_m)


class StandardSta(NamedTuple):
    """The functions that synthesise the standard STA.

    The loop is stiff with them, because k_o tau_av and tau_m go to 0 with sigma. An r below ``ROOT_FLOOR`` counts as
    ``ROOT_FLOOR``, so that nothing is divided by 0.
    """

    kappa1: Annotated[Scalar, KAPPA_1]
    kappa2: Annotated[Scalar, KAPPA_2]
    k_o: Annotated[Scalar | None, K_O] = None
    tau_av: Annotated[Scalar | None, TAU_AV] = None

    prepare = require_one_factor
    sampled_form = Discretisation.IMPLICIT  # the slope of phi_1 is infinite at 0
    tunable = ("kappa1", "kappa2")
    finite_slope = False
    smooth = not_smooth(f"with the functions of the standard STA {SWITCHES}")

    def at(self, sigma: Scalar, e: Scalar, l0: Scalar) -> StateFunctions:
        """Table 2, row 2: k_o tau_av = 2 r/kappa1 (printed with phi_1 for phi_1'), tau_m = (kappa1/kappa2) r.

        k_o, tau_av and tau_m depend on sigma [y/s] alone, not on e and l0.
        """
        r = root_abs(sigma, ROOT_FLOOR)
        return factors(2.0 * r / self.kappa1, self.kappa1 / self.kappa2 * r, self.k_o, self.tau_av)

    def super_twisting(self) -> SuperTwisting:
        """The STA with these gains, which the functions synthesise exactly: no smoothing."""
        return SuperTwisting(self.kappa1, self.kappa2, 0.0)

    def law(self, sigma: Scalar, e: Scalar, at: StateFunctions) -> IntegratedLaw:
        """phi_1 = kappa1 r sgn sigma, phi_2 = (kappa2/2) sgn sigma.

        The gain is phi_1/sigma = kappa1/r, and the rate is phi_2/phi_1 = 1/(2 tau_m).
        """
        return IntegratedLaw(self.kappa1 / root_abs(sigma, ROOT_FLOOR), 0.5 / at.tau_m)


class ApproximateSta1(NamedTuple):
    """The functions of the first approximation of the STA.

    These functions are smooth at sigma = 0, too, where tau_m = 2 delta kappa1/kappa2.
    """

    kappa1: Annotated[Scalar, KAPPA_1]
    kappa2: Annotated[Scalar, KAPPA_2]
    delta: Annotated[Scalar, DELTA]
    k_o: Annotated[Scalar | None, K_O] = None
    tau_av: Annotated[Scalar | None, TAU_AV] = None

    prepare = require_one_factor
    sampled_form = Discretisation.CONSERVATIVE
    tunable = ("kappa1", "kappa2")
    finite_slope = True
    smooth = SMOOTH

    def at(self, sigma: Scalar, e: Scalar, l0: Scalar) -> StateFunctions:
        """Table 2, row 3: tau_m = (kappa1/kappa2) r/[1 - (delta/r) ln((r + delta)/delta)].

        With x = r/delta the quotient is delta x^2/(x - ln(1 + x)), which is 2 delta at r = 0.
        """
        r = root_abs(sigma)
        tau_m = self.kappa1 * self.delta / (self.kappa2 * log_defect(r / self.delta))
        return factors(2.0 * (r + self.delta) / self.kappa1, tau_m, self.k_o, self.tau_av)

    def super_twisting(self) -> SuperTwisting:
        """The STA with these gains and this smoothing."""
        return SuperTwisting(self.kappa1, self.kappa2, self.delta)

    def law(self, sigma: Scalar, e: Scalar, at: StateFunctions) -> IntegratedLaw:
        """phi_1 = kappa1 (r - delta ln(1 + r/delta)) sgn sigma.

        ``root_law`` gives the gain phi_1/sigma and the rate phi_2/phi_1; e is not needed.
        """
        return root_law(self.kappa1, root_abs(sigma), self.delta, at.tau_m)


class ApproximateSta2(NamedTuple):
    """The functions of the second approximation of the STA.

    They are those of the standard STA with r + delta in place of r, so that k_o tau_av and tau_m stay positive at sigma
    = 0.
    """

    kappa1: Annotated[Scalar, KAPPA_1]
    kappa2: Annotated[Scalar, KAPPA_2]
    delta: Annotated[Scalar, DELTA]
    k_o: Annotated[Scalar | None, K_O] = None
    tau_av: Annotated[Scalar | None, TAU_AV] = None

    prepare = require_one_factor
    sampled_form = Discretisation.CONSERVATIVE
    tunable = ("kappa1", "kappa2")
    finite_slope = True
    smooth = SMOOTH

    def at(self, sigma: Scalar, e: Scalar, l0: Scalar) -> StateFunctions:
        """Table 2, row 4: k_o tau_av = 2 (r + delta)/kappa1, tau_m = (kappa1/kappa2)(r + delta).

        k_o, tau_av and tau_m depend on sigma [y/s] alone, not on e and l0.
        """
        r = root_abs(sigma) + self.delta
        return factors(2.0 * r / self.kappa1, self.kappa1 / self.kappa2 * r, self.k_o, self.tau_av)

    def super_twisting(self) -> SuperTwisting:
        """The STA with these gains and this smoothing."""
        return SuperTwisting(self.kappa1, self.kappa2, self.delta)

    def law(self, sigma: Scalar, e: Scalar, at: StateFunctions) -> IntegratedLaw:
        """phi_1 as of row 3; phi_2 = (kappa2/2) sigma/(r + delta)^2."""
        return root_law(self.kappa1, root_abs(sigma), self.delta, at.tau_m)


class SquareRoot(NamedTuple):
    """The functions of the article's simulations (Section V-B)."""

    kappa_o: Annotated[Scalar, Quantity("y/(s^2 u) (y/s)^(-1/2)", "predictor gain's slope kappa_o", above=0.0)]
    kappa_m: Annotated[Scalar, Quantity("s (y/s)^(-1/2)", "predictor time constant's slope kappa_m", above=0.0)]
    delta_o: Annotated[Scalar, DELTA]
    delta_m: Annotated[Scalar, DELTA]
    tau_av: Annotated[Scalar, TAU_AV]

    sampled_form = Discretisation.CONSERVATIVE
    tunable = ("kappa_o", "kappa_m")
    finite_slope = True
    smooth = SMOOTH

    def at(self, sigma: Scalar, e: Scalar, l0: Scalar) -> StateFunctions:
        """k_o = kappa_o (r + delta_o), tau_m = kappa_m (r + delta_m).

        tau_av is constant. k_o and tau_m depend on sigma [y/s] alone, not on e and l0.
        """
        r = root_abs(sigma)
        return StateFunctions(self.kappa_o * (r + self.delta_o), self.tau_av, self.kappa_m * (r + self.delta_m))

    def super_twisting(self) -> SuperTwisting:
        """The STA that row 4 of Table 2 approximates, which has these functions if both delta agree."""
        kappa1 = 2.0 / (self.kappa_o * self.tau_av)
        return SuperTwisting(kappa1, kappa1 / self.kappa_m, self.delta_o)

    def law(self, sigma: Scalar, e: Scalar, at: StateFunctions) -> IntegratedLaw:
        """phi_1 as of Table 2, row 3, with kappa1 = 2/(kappa_o tau_av)."""
        return root_law(2.0 / (self.kappa_o * at.tau_av), root_abs(sigma), self.delta_o, at.tau_m)


class Field(NamedTuple):
    """The functions of the article's field test (Section V-C).

    Only here kappa_2 multiplies sgn itself; Table 2 multiplies sgn by kappa_2/2.
    """

    k_o: Annotated[Scalar, K_O]
    kappa1: Annotated[Scalar, KAPPA_1]
    kappa2: Annotated[Scalar, Quantity("u/s", "integral gain kappa_2, multiplying sgn itself", above=0.0)]
    delta: Annotated[Scalar, Quantity("s", "smoothing delta of both time constants", above=0.0)]

    sampled_form = Discretisation.CONSERVATIVE
    tunable = ("kappa1", "kappa2")
    finite_slope = True
    smooth = SMOOTH

    def at(self, sigma: Scalar, e: Scalar, l0: Scalar) -> StateFunctions:
        """tau_av = 2 r/(k_o kappa1) + delta, tau_m = kappa1 r/(2 kappa2) + delta.

        k_o is constant. tau_av and tau_m depend on sigma [y/s] alone, not on e and l0.
        """
        r = root_abs(sigma)
        tau_av = 2.0 * r / (self.k_o * self.kappa1) + self.delta
        return StateFunctions(self.k_o, tau_av, self.kappa1 * r / (2.0 * self.kappa2) + self.delta)

    def super_twisting(self) -> SuperTwisting:
        """The STA in the normalisation of Table 2, whose kappa_2 is twice the one that multiplies sgn itself."""
        delta = 0.5 * self.delta * self.k_o * self.kappa1
        return SuperTwisting(self.kappa1, 2.0 * self.kappa2, delta)

    def law(self, sigma: Scalar, e: Scalar, at: StateFunctions) -> IntegratedLaw:
        """phi_1 as of Table 2, row 3, with k_o kappa1 delta/2 for delta."""
        return root_law(self.kappa1, root_abs(sigma), 0.5 * self.k_o * self.kappa1 * self.delta, at.tau_m)


KAPPA_ABC = "variable gain's coefficient"


class VariableGains(NamedTuple):
    """The variable gains of Section IV-B at one sample.

    Args:
        kappa1: kappa_1.
        kappa2: kappa_2.
        by_sigma: Derivative of kappa_1 with respect to sigma.
        by_e: Derivative of kappa_1 with respect to e.
    """

    kappa1: Scalar
    kappa2: Scalar
    by_sigma: Scalar
    by_e: Scalar


def variable_gains(
    sigma: Scalar, e: Scalar, coefficients: tuple[Scalar, Scalar, Scalar, Scalar], epsilon: Scalar, gamma: Scalar
) -> VariableGains:
    """kappa_1 = (kappa_a |sigma| + kappa_b |e| + kappa_c)^2 + kappa_d and kappa_2 = 2 eps kappa_1 + gamma.

    Args:
        sigma: Sliding variable [y/s].
        e: Control error [y].
        coefficients: kappa_a, kappa_b, kappa_c, kappa_d.
        epsilon: Share eps of kappa_2 that follows kappa_1.
        gamma: Constant part of kappa_2.

    Returns:
        Both gains, and the derivatives of kappa_1: 2 kappa kappa_a sgn(sigma) and 2 kappa kappa_b sgn(e), where kappa
        is the sum in parentheses.
    """
    kappa_a, kappa_b, kappa_c, kappa_d = coefficients
    kappa = kappa_a * abs(sigma) + kappa_b * abs(e) + kappa_c
    kappa1 = kappa * kappa + kappa_d
    return VariableGains(
        kappa1=kappa1,
        kappa2=2.0 * epsilon * kappa1 + gamma,
        by_sigma=2.0 * kappa * kappa_a * sign(sigma),
        by_e=2.0 * kappa * kappa_b * sign(e),
    )


class Vgsta(NamedTuple):
    """The functions of Table 1, which synthesise an approximation of the variable-gain STA.

    tau_m > 0 for every (sigma, e) needs phi_b > l_0/eps and kappa_a >= kappa_b/l_0, two of Table 1's inequalities;
    otherwise the predictor can be unstable, which the draws then show.
    """

    phi_a: Annotated[Scalar, Quantity("(y/s)^(1/2)", "square-root part phi_a", at_least=0.0)]
    phi_b: Annotated[Scalar, Quantity("1", "linear part phi_b", above=0.0)]
    kappa_a: Annotated[Scalar, Quantity("SI", f"{KAPPA_ABC} of |sigma|, kappa_a", at_least=0.0)]
    kappa_b: Annotated[Scalar, Quantity("SI", f"{KAPPA_ABC} of |e|, kappa_b", at_least=0.0)]
    kappa_c: Annotated[Scalar, Quantity("SI", f"{KAPPA_ABC} kappa_c", at_least=0.0)]
    kappa_d: Annotated[Scalar, Quantity("SI", f"{KAPPA_ABC} kappa_d", above=0.0)]
    epsilon: Annotated[Scalar, Quantity("SI", "integral gain's share eps", above=0.0)]
    gamma: Annotated[Scalar, Quantity("SI", "integral gain's offset gamma", at_least=0.0)]
    delta: Annotated[Scalar, DELTA]
    k_o: Annotated[Scalar | None, K_O] = None
    tau_av: Annotated[Scalar | None, TAU_AV] = None

    prepare = require_one_factor
    sampled_form = Discretisation.CONSERVATIVE
    tunable = ("kappa_d", "gamma")
    finite_slope = True
    smooth = piecewise("the jump of tau_m at e = 0")

    def gains(self, sigma: Scalar, e: Scalar) -> VariableGains:
        """The variable gains kappa_1 and kappa_2 at sigma and e, with the derivatives of kappa_1."""
        coefficients = (self.kappa_a, self.kappa_b, self.kappa_c, self.kappa_d)
        return variable_gains(sigma, e, coefficients, self.epsilon, self.gamma)

    def ratio(self, sigma: Scalar) -> tuple[Scalar, Scalar]:
        """phi_1/sigma = phi_a/(r + delta) + phi_b of (26), and phi_1's derivative.

        Both are finite at sigma = 0, because delta > 0.
        """
        rd = root_abs(sigma) + self.delta  # r + delta
        return self.phi_a / rd + self.phi_b, self.phi_a * (rd + self.delta) / (2.0 * rd * rd) + self.phi_b

    def at(self, sigma: Scalar, e: Scalar, l0: Scalar) -> StateFunctions:
        """The factors of the law from the functions (28) and (29) of the article, with phi_1 of (26).

        The code writes phi_1 = ratio sigma, with ratio = phi_a/(r + delta) + phi_b. kappa_1 has kinks at sigma = 0 and
        e = 0; there sgn 0 = 0, so tau_m jumps at e = 0. Table 1 of the article misprints the first factor of tau_m's
        denominator: phi_b stands where phi_a must.

        Args:
            sigma: Sliding variable [y/s].
            e: Control error [y].
            l0: Error pole l_0 [1/s].
        """
        ratio, slope = self.ratio(sigma)
        gains = self.gains(sigma, e)
        inverse_product = gains.by_sigma * ratio * sigma + gains.kappa1 * slope
        tau_m = inverse_product / (ratio * (gains.by_e * (sigma - l0 * e) + gains.kappa2 * slope))
        return factors(1.0 / inverse_product, tau_m, self.k_o, self.tau_av)

    def super_twisting(self) -> SuperTwisting:
        """The STA that the law approaches near the origin, where its square-root part phi_a rules over phi_b."""
        at = self.gains(0.0, 0.0)
        return SuperTwisting(at.kappa1 * self.phi_a, at.kappa2 * self.phi_a**2, self.delta)

    def law(self, sigma: Scalar, e: Scalar, at: StateFunctions) -> IntegratedLaw:
        """The variable-gain STA's own: kappa_1 phi_1 and kappa_2 phi_2 of (26).

        The law is kappa_1 phi_1 + integral of kappa_2 phi_2, with phi_1 and phi_2 of (26). Its first term stands for
        phi_1 of :class:`IntegratedLaw`, and the rate is kappa_2 phi_2 over the first term. tau_m also contains the part
        of d(kappa_1 phi_1)/dt that comes from e' = sigma - l0 e. This part belongs to the first term, so the second
        term is kappa_2 phi_2 = kappa_2 phi_1' phi_1 alone. ``at`` is not needed here.
        """
        gains = self.gains(sigma, e)
        ratio, slope = self.ratio(sigma)
        return IntegratedLaw(gains.kappa1 * ratio, gains.kappa2 * slope / gains.kappa1)


TABLE_1_EXAMPLE = {
    "phi_a": 0.5, "phi_b": 0.5, "kappa_a": 0.5, "kappa_b": 0.5, "kappa_c": 0.5, "kappa_d": 0.5,
    "epsilon": 0.5, "gamma": 1.0, "delta": 0.1,
}  # fmt: skip

GAIN_FUNCTIONS: Registry = {
    "constant": single(Constant, "constants: SSC, synthesises PI (Table 2 row 1)", k_o=10.0, tau_av=0.1, tau_m=1.0),
    "sta": single(StandardSta, "standard STA, stiff (Table 2 row 2)", kappa1=1.0, kappa2=1.0, k_o=10.0),
    "approx_sta_1": single(
        ApproximateSta1, "first approximation of the STA (Table 2 row 3)", kappa1=1.0, kappa2=1.0, delta=0.5, tau_av=0.1
    ),
    "approx_sta_2": single(
        ApproximateSta2, "second approximation of the STA (Table 2 row 4)", kappa1=1.0, kappa2=1.0, delta=0.5, k_o=10.0
    ),
    "square_root": single(
        SquareRoot,
        "the article's simulations (Section V-B)",
        kappa_o=50.0,
        kappa_m=2.0,
        delta_o=1.0,
        delta_m=1.0,
        tau_av=0.03,
    ),
    "field": single(Field, "the article's field test (Section V-C)", k_o=10.0, kappa1=0.5, kappa2=0.1, delta=0.1),
    "vgsta": single(Vgsta, "approximation of the variable-gain STA (Table 1)", **TABLE_1_EXAMPLE, tau_av=0.1),
}
