"""The gains of a region of sigma and e, enclosed in balls: the verifier's own rows of Tables 1 and 2."""

from itertools import pairwise, product
from typing import Any

from flint import arb

from dssc_jax.proofs.balls import Rejected, enclosing, larger, require_premise

PIECES = 160  # of |sigma|, and others of e for functions of both, on which the gains are enclosed
ERROR_PIECES = 64
Balls = dict[str, arb]


def enclosed_gains(problem: dict[str, Any], sigma: float, e: float) -> Balls:
    """Balls of K_P, K_I, K_N, of the sliding condition's gains, and of tau_av for |sigma| and |e| up to bounds."""
    of_both = problem["functions"]["kind"] == "vgsta"
    steps = [e * (2 * i / ERROR_PIECES - 1) for i in range(ERROR_PIECES + 1)]
    errors = [enclosing(*pair) for pair in pairwise(steps)] if of_both else [arb(0)]
    result: Balls = {}
    for cut in pairwise([0.0, *(sigma * (i / PIECES) ** 2 for i in range(1, PIECES)), sigma]):
        for error, sign in product(errors, (1, -1) if of_both else (1,)):
            for name, ball in gains_at(problem, cut, sign, error).items():
                result[name] = result[name].union(ball) if name in result else ball
    if problem["form"] == "conservative":  # K_P is a mean over sigma, tau_av belongs to its last value
        result["slide_p"] = result["k_p"] * (1 + result["tau_av"] / arb(problem["sample_time"]))
    return result


def gains_at(problem: dict[str, Any], size: tuple[float, float], sign: int, e: arb) -> Balls:
    """The gains for |sigma| in an interval, a sign of sigma, and e in a ball."""
    product_, tau_m = functions_at(problem, size, sign, e)
    t, own = arb(problem["sample_time"]), problem["functions"]
    proportional = 1 / product_
    filtered = 1 / arb(own["k_o"]) if "k_o" in own else arb(own["tau_av"]) * proportional  # tau_av K_P
    integral = proportional / tau_m  # phi_2/sigma in the conservative form, too
    nominal = problem["nominal"]
    pole = 1 / (tau_m * arb(nominal[1])) if nominal and nominal[2] else arb(0)
    return {
        "k_p": proportional,
        "k_i": integral,
        "k_n": pole,
        "slide_p": proportional + filtered / t,
        "slide_i": t * integral + filtered / tau_m,
        "tau_av": filtered * product_,
    }


def functions_at(problem: dict[str, Any], size: tuple[float, float], sign: int, e: arb) -> tuple[arb, arb]:
    """k_o tau_av and tau_m: the rows of Tables 1 and 2, and of Section V."""
    own = {name: arb(value) for name, value in problem["functions"].items() if name != "kind"}
    kind = problem["functions"]["kind"]
    low, high = (arb(end).sqrt() for end in size)
    r = low.union(high)
    match kind:
        case "constant":
            product_, tau_m = own["k_o"] * own["tau_av"], own["tau_m"]
        case "sta":
            floor = arb(1e-9)
            r = larger(low, floor).union(larger(high, floor))
            product_, tau_m = 2 * r / own["kappa1"], own["kappa1"] / own["kappa2"] * r
        case "approx_sta_1":
            product_ = 2 * (r + own["delta"]) / own["kappa1"]
            defect = over_defect(low / own["delta"]).union(over_defect(high / own["delta"]))
            tau_m = own["kappa1"] / own["kappa2"] * own["delta"] * defect
        case "approx_sta_2":
            product_ = 2 * (r + own["delta"]) / own["kappa1"]
            tau_m = own["kappa1"] / own["kappa2"] * (r + own["delta"])
        case "square_root":
            product_ = own["kappa_o"] * (r + own["delta_o"]) * own["tau_av"]
            tau_m = own["kappa_m"] * (r + own["delta_m"])
        case "field":
            product_ = 2 * r / own["kappa1"] + own["delta"] * own["k_o"]
            tau_m = own["kappa1"] * r / (2 * own["kappa2"]) + own["delta"]
        case "vgsta":
            product_, tau_m = table_1(own, arb(problem["l0"]), r, sign, e)
        case _:
            raise Rejected(f"P2: unknown functions '{kind}'")
    require_premise(bool(product_ > 0) and bool(tau_m > 0), "P2: the functions are not positive in the region")
    return product_, tau_m


def over_defect(x: arb) -> arb:
    """x^2/(x - ln(1 + x)) for x >= 0, with the limit 2 at 0; it rises, so its values at both ends enclose it."""
    if x < arb("1e-12"):  # 2 + 4 x/3 - ..., within [2, 2 + 2 x]
        return arb(2).union(2 + 2 * x)
    return x * x / (x - x.log1p())


def table_1(own: Balls, l0: arb, r: arb, sign: int, e: arb) -> tuple[arb, arb]:
    """(28) and (29): k_o tau_av and tau_m, with r = |sigma|^(1/2)."""
    rd, size = r + own["delta"], r * r
    ratio = own["phi_a"] / rd + own["phi_b"]
    slope = own["phi_a"] * (rd + own["delta"]) / (2 * rd * rd) + own["phi_b"]
    kappa = own["kappa_a"] * size + own["kappa_b"] * abs(e) + own["kappa_c"]
    kappa1 = kappa * kappa + own["kappa_d"]
    kappa2 = 2 * own["epsilon"] * kappa1 + own["gamma"]
    sign_e = arb(1) if e > 0 else arb(-1) if e < 0 else enclosing(-1.0, 1.0)
    by_e = 2 * kappa * own["kappa_b"] * sign_e
    inverse = 2 * kappa * own["kappa_a"] * ratio * size + kappa1 * slope
    tau_m = inverse / (ratio * (by_e * (sign * size - l0 * e) + kappa2 * slope))
    return 1 / inverse, tau_m
