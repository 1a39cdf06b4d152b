"""The gains of a region of sigma and e, enclosed in balls: the verifier's own rows of Table 2 and of Section V."""

import math
from typing import Any

from flint import arb

from dssc_jax.proofs.verifier.balls import Balls, Rejected, enclosing, larger, require_premise
from dssc_jax.proofs.verifier.table_gains import table_gains

PRECISE = 0.03  # largest excess of a hull over the gains themselves, in widths of the hull
ROUNDING = 2.0**-40  # and in sizes of the gain
MOST_PIECES = 6000
SMALLEST_ROOM = 1e-300
SMALLEST_REGION = 1e-12  # of the starts


class PointHull:
    """The hull of the gains at points, which their enclosure cannot be smaller than."""

    def __init__(self, problem: dict[str, Any]) -> None:
        """Without a point."""
        self.problem = problem
        self.ends: dict[str, tuple[float, float]] = {}

    def add(self, size: float) -> None:
        """Take in the gains at one |sigma|."""
        for name, ball in gains_at(self.problem, (size, size)).items():
            value, (low, high) = float(ball.mid()), self.ends.get(name, (math.inf, -math.inf))
            self.ends[name] = (min(low, value), max(high, value))

    def rooms(self) -> dict[str, float]:
        """By how much a ball may exceed the hull."""
        return {
            name: PRECISE * (high - low) + ROUNDING * max(abs(low), abs(high)) + SMALLEST_ROOM
            for name, (low, high) in self.ends.items()
        }

    def exceeded(self, balls: Balls, rooms: dict[str, float]) -> bool:
        """Whether balls widen the hull by too much."""
        return not all(
            ball > self.ends[name][0] - rooms[name] and ball < self.ends[name][1] + rooms[name]
            for name, ball in balls.items()
        )


def enclosed_gains(problem: dict[str, Any], sigma: float, e: float, least: float = 0.0, least_e: float = 0.0) -> Balls:
    """Balls of the gains for |sigma| and |e| from their least values to a bound.

    Of K_P, K_I, K_N, of the sliding condition's gains, and in the conservative form of phi_1/sigma and of what phi_1
    changes by with e. Table 1's functions depend on e: :func:`dssc_jax.proofs.verifier.table_gains.table_gains`.
    """
    if problem["functions"]["kind"] == "vgsta":
        result = table_gains(problem, sigma, e, least, least_e)
    else:
        result = gains_by_sigma(problem, sigma, least)
    if problem["form"] == "conservative":  # K_P is a mean over a sample, tau_av belongs to its end
        reach = 1 + result["tau_av"] / arb(problem["sample_time"])
        result["slide_p"] = result["k_p"] * reach
        result["slide_e"] = result.get("k_e", arb(0)) * reach
    return result


def gains_by_sigma(problem: dict[str, Any], sigma: float, least: float) -> Balls:
    """Balls of the gains that depend on sigma alone.

    The interval of |sigma| is halved in |sigma|^(1/2) where a piece's ball exceeds the hull of the gains at points by
    more than a small share of its width.
    """
    pieces, points, result, left = [(least, sigma)], PointHull(problem), Balls(), MOST_PIECES
    for end in (least, sigma):
        points.add(end)
    while pieces:
        for piece in pieces:
            points.add(middle_of(piece))
        rooms, left, after = points.rooms(), left - len(pieces), []
        for piece in pieces:
            low, high, middle = *piece, middle_of(piece)
            try:
                balls = gains_at(problem, piece)
            except Rejected:  # too wide a ball, since every point was fine
                require_premise(left > 0, "P2: the functions cannot be enclosed in the region")
                after += [(low, middle), (middle, high)]
                continue
            if left > 0 and points.exceeded(balls, rooms):
                after += [(low, middle), (middle, high)]
                continue
            for name, ball in balls.items():
                result[name] = result[name].union(ball) if name in result else ball
        pieces = after
    return result


def enclosed_start_ratio(problem: dict[str, Any], *, integrated: bool) -> arb:
    """What the start takes from u_av, over sigma_0, as a ball that holds it for every start.

    Seen from sigma_hat = sigma_0, the start ``midpoint`` halves the first T_s phi_2. ``integrated``: the coordinate is
    q = v - phi_1(sigma_0).
    """
    if problem["start"] == "zero":
        return arb(0)
    e, speed = (enclosing(*pair) for pair in problem["initial"][:2])
    least, largest = size_ends(speed + arb(problem["l0"]) * e)
    gains = enclosed_gains(problem, largest, size_ends(e)[1], least, size_ends(e)[0])
    ratio = gains["mean"] if integrated else arb(0)
    if problem["start"] == "midpoint":
        ratio = ratio + arb(problem["sample_time"]) / 2 * gains["k_i"]
    return ratio


def size_ends(ball: arb) -> tuple[float, float]:
    """Bounds of |x| over a ball, rounded outwards; the larger is positive."""
    size = abs(ball)
    least, largest = float(size.lower()), float(size.upper())
    return max(0.0, math.nextafter(least, -math.inf)), max(math.nextafter(largest, math.inf), SMALLEST_REGION)


def with_moving_error(problem: dict[str, Any], gains: Balls, moved: float) -> Balls:
    """The gains of the increments of u_av, where e changes by at most ``moved`` in a sample.

    In the conservative form phi_1(sigma_k, e_k) - phi_1(sigma_k, e_(k-1)) is sigma_k times a gain, which joins T_s K_I.
    """
    if not depends_on_error(problem):
        return gains
    joins = enclosing(-1.0, 1.0) * abs(gains["by_e"]).upper() * arb(moved)
    t = arb(problem["sample_time"])
    reach = 1 + gains["tau_av"] / t
    return gains | {"k_i": gains["k_i"] + joins / t, "slide_i": gains["slide_i"] + joins * reach}


def depends_on_error(problem: dict[str, Any]) -> bool:
    """Whether phi_1 of the conservative form changes with e."""
    return problem["form"] == "conservative" and bool(problem["functions"].get("kappa_b", 0))


def middle_of(piece: tuple[float, float]) -> float:
    """The middle of an interval of |sigma|, in |sigma|^(1/2)."""
    return (0.5 * (piece[0] ** 0.5 + piece[1] ** 0.5)) ** 2


def gains_at(problem: dict[str, Any], size: tuple[float, float]) -> Balls:
    """The gains for |sigma| in an interval."""
    product_, tau_m = functions_at(problem, size)
    t, own = arb(problem["sample_time"]), problem["functions"]
    proportional = 1 / product_
    filtered = 1 / arb(own["k_o"]) if "k_o" in own else arb(own["tau_av"]) * proportional  # tau_av K_P
    integral = proportional / tau_m  # phi_2/sigma in the conservative form, too
    nominal = problem["nominal"]
    pole = 1 / (tau_m * arb(nominal[1])) if nominal and nominal[2] else arb(0)
    mean = {"mean": mean_gain(own, size, product_)} if problem["form"] == "conservative" else {}
    return mean | {
        "k_p": proportional,
        "k_i": integral,
        "k_n": pole,
        "slide_p": proportional + filtered / t,
        "slide_i": t * integral + filtered / tau_m,
        "tau_av": arb(own["tau_av"]) if "tau_av" in own else product_ / arb(own["k_o"]),
    }


def functions_at(problem: dict[str, Any], size: tuple[float, float]) -> tuple[arb, arb]:
    """k_o tau_av and tau_m for |sigma| in an interval: the rows of Table 2 and of Section V."""
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
        case _:
            raise Rejected(f"P2: unknown functions '{kind}'")
    require_premise(bool(product_ > 0) and bool(tau_m > 0), "P2: the functions are not positive in the region")
    return product_, tau_m


def mean_gain(functions: dict[str, Any], size: tuple[float, float], product_: arb) -> arb:
    """phi_1/sigma, the mean of K_P over [0, sigma], where k_o tau_av is alpha (r + beta) with r = |sigma|^(1/2)."""
    own = {name: arb(value) for name, value in functions.items() if name != "kind"}
    match functions["kind"]:
        case "constant":
            return 1 / product_
        case "approx_sta_1" | "approx_sta_2":
            alpha, beta = 2 / own["kappa1"], own["delta"]
        case "square_root":
            alpha, beta = own["kappa_o"] * own["tau_av"], own["delta_o"]
        case "field":
            alpha, beta = 2 / own["kappa1"], own["delta"] * own["k_o"] * own["kappa1"] / 2
        case kind:
            raise Rejected(f"P2: phi_1 of the functions '{kind}' is not known")
    low, high = (over_defect(arb(end).sqrt() / beta) for end in size)
    return 2 / (alpha * beta * low.union(high))


def over_defect(x: arb) -> arb:
    """x^2/(x - ln(1 + x)) for x >= 0, with the limit 2 at 0; it rises, so its values at both ends enclose it."""
    if x < arb("1e-12"):  # 2 + 4 x/3 - ..., within [2, 2 + 2 x]
        return arb(2).union(2 + 2 * x)
    return x * x / (x - x.log1p())
