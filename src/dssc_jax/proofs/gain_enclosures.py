"""The gains of a region of sigma and e, enclosed in balls: the verifier's own rows of Tables 1 and 2."""

import math
from itertools import product
from typing import Any, NamedTuple

from flint import arb

from dssc_jax.proofs.balls import Rejected, enclosing, larger, require_premise

PRECISE = 0.03  # largest excess of a hull over the gains themselves, in widths of the hull
ROUNDING = 2.0**-40  # and in sizes of the gain
MOST_PIECES = 6000
SMALLEST_ROOM = 1e-300
Balls = dict[str, arb]


class RegionPiece(NamedTuple):
    """Intervals of |sigma| and |e|, and the sign of sigma e: the gains are the same at (-sigma, -e)."""

    size: tuple[float, float]
    sign: int
    e: tuple[float, float]

    def halves(self, by_e: bool) -> list["RegionPiece"]:
        """Both halves, in r = |sigma|^(1/2) or in |e|."""
        (low, high), (left, right), middle = self.size, self.e, self.middle()
        if by_e:
            return [self._replace(e=(left, middle.e[0])), self._replace(e=(middle.e[0], right))]
        return [self._replace(size=(low, middle.size[0])), self._replace(size=(middle.size[0], high))]

    def middle(self) -> "RegionPiece":
        """Its middle, a point."""
        cut, e = (0.5 * (self.size[0] ** 0.5 + self.size[1] ** 0.5)) ** 2, 0.5 * (self.e[0] + self.e[1])
        return self._replace(size=(cut, cut), e=(e, e))

    def corners(self) -> list["RegionPiece"]:
        """Its corners, each a point."""
        return [self._replace(size=(size, size), e=(e, e)) for size, e in product(self.size, self.e)]


class PointHull:
    """The hull of the gains at points, which their enclosure cannot be smaller than."""

    def __init__(self, problem: dict[str, Any]) -> None:
        """Without a point."""
        self.problem = problem
        self.ends: dict[str, tuple[float, float]] = {}

    def add(self, point: RegionPiece) -> None:
        """Take in a point."""
        for name, ball in gains_at(self.problem, point).items():
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


def enclosed_gains(problem: dict[str, Any], sigma: float, e: float, least: float = 0.0) -> Balls:
    """Balls of the gains for |sigma| from ``least`` to a bound, and |e| up to one.

    Of K_P, K_I, K_N, of the sliding condition's gains, of tau_av, and in the conservative form of phi_1/sigma. The
    region is halved where a piece's ball exceeds the hull of the gains at points by more than a small share of its
    width; in |sigma|^(1/2) or in e, whichever varies the gains more.
    """
    of_both = problem["functions"]["kind"] == "vgsta"
    signs, ends = ((1, -1), (0.0, e)) if of_both else ((1,), (0.0, 0.0))
    pieces = [RegionPiece((least, sigma), sign, ends) for sign in signs]
    points, result, left = PointHull(problem), Balls(), MOST_PIECES
    for piece in pieces:
        for corner in piece.corners():
            points.add(corner)
    while pieces:
        for piece in pieces:
            points.add(piece.middle())
        rooms, left, after = points.rooms(), left - len(pieces), []
        for piece in pieces:
            try:
                balls = gains_at(problem, piece)
            except Rejected:  # too wide a ball, since every point was fine
                require_premise(left > 0, "P2: the functions cannot be enclosed in the region")
                after += [part for half in piece.halves(False) for part in (half.halves(True) if of_both else [half])]
                continue
            if left > 0 and points.exceeded(balls, rooms):
                after += piece.halves(of_both and varies_with_e(problem, piece, rooms))
                continue
            for name, ball in balls.items():
                result[name] = result[name].union(ball) if name in result else ball
        pieces = after
    if problem["form"] == "conservative":  # K_P is a mean over sigma, tau_av belongs to its last value
        result["slide_p"] = result["k_p"] * (1 + result["tau_av"] / arb(problem["sample_time"]))
    return result


def varies_with_e(problem: dict[str, Any], piece: RegionPiece, rooms: dict[str, float]) -> bool:
    """Whether the gains vary more with e than with sigma in a piece."""
    middle = piece.middle()
    by_size, by_e = (gains_at(problem, each) for each in (piece._replace(e=middle.e), piece._replace(size=middle.size)))
    return max(float(by_e[name].rad()) / rooms[name] for name in by_e) > max(
        float(by_size[name].rad()) / rooms[name] for name in by_size
    )


def gains_at(problem: dict[str, Any], piece: RegionPiece) -> Balls:
    """The gains in a piece of the region."""
    product_, tau_m = functions_at(problem, piece.size, piece.sign, enclosing(*piece.e))
    t, own = arb(problem["sample_time"]), problem["functions"]
    proportional = 1 / product_
    filtered = 1 / arb(own["k_o"]) if "k_o" in own else arb(own["tau_av"]) * proportional  # tau_av K_P
    integral = proportional / tau_m  # phi_2/sigma in the conservative form, too
    nominal = problem["nominal"]
    pole = 1 / (tau_m * arb(nominal[1])) if nominal and nominal[2] else arb(0)
    mean = {"mean": mean_gain(own, piece.size, product_)} if problem["form"] == "conservative" else {}
    return mean | {
        "k_p": proportional,
        "k_i": integral,
        "k_n": pole,
        "slide_p": proportional + filtered / t,
        "slide_i": t * integral + filtered / tau_m,
        "tau_av": arb(own["tau_av"]) if "tau_av" in own else product_ / arb(own["k_o"]),
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


def table_1(own: Balls, l0: arb, r: arb, sign: int, e: arb) -> tuple[arb, arb]:
    """(28) and (29): k_o tau_av and tau_m, with r = |sigma|^(1/2), the sign of sigma e, and e = |e|.

    At e = 0, where sgn e jumps, both signs are taken; with sgn 0 = 0 the gains lie between.
    """
    rd, size = r + own["delta"], r * r
    ratio = own["phi_a"] / rd + own["phi_b"]
    slope = own["phi_a"] * (rd + own["delta"]) / (2 * rd * rd) + own["phi_b"]
    kappa = own["kappa_a"] * size + own["kappa_b"] * e + own["kappa_c"]
    kappa1 = kappa * kappa + own["kappa_d"]
    kappa2 = 2 * own["epsilon"] * kappa1 + own["gamma"]
    by_e = 2 * kappa * own["kappa_b"]
    inverse = 2 * kappa * own["kappa_a"] * ratio * size + kappa1 * slope
    tau_m = inverse / (ratio * (by_e * (sign * size - l0 * e) + kappa2 * slope))
    return 1 / inverse, tau_m
