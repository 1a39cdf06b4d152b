"""The gains in a region of sigma and e, enclosed in balls: the verifier's own rows of Table 2 and Section V."""

import math

from flint import arb

from dssc_jax.proofs.verifier.balls import Balls, Rejected, interval_ball, maximum, require_premise
from dssc_jax.proofs.verifier.certificate import Problem
from dssc_jax.proofs.verifier.table_gains import table_gains

PRECISE = 0.03  # largest excess of a hull over the gains themselves, in widths of the hull
ROUNDING = 2.0**-40  # and in sizes of the gain
MOST_PIECES = 6000
SMALLEST_ROOM = 1e-300
SMALLEST_REGION = 1e-12  # smallest bound of |sigma| and |e| at the start


class PointHull:
    """The hull of the gains at some points: an enclosure of the gains contains it, and should not be much larger."""

    def __init__(self, problem: Problem) -> None:
        """An empty hull."""
        self.problem = problem
        self.ends: dict[str, tuple[float, float]] = {}

    def add(self, size: float) -> None:
        """Extend the hull by the gains at one |sigma|."""
        for name, ball in gains_at(self.problem, (size, size)).items():
            value = float(ball.mid())
            low, high = self.ends.get(name, (math.inf, -math.inf))
            self.ends[name] = (min(low, value), max(high, value))

    def rooms(self) -> dict[str, float]:
        """The largest excess of a ball over the hull that is allowed, by gain."""
        return {
            name: PRECISE * (high - low) + ROUNDING * max(abs(low), abs(high)) + SMALLEST_ROOM
            for name, (low, high) in self.ends.items()
        }

    def is_exceeded_by(self, balls: Balls, rooms: dict[str, float]) -> bool:
        """Whether a ball exceeds the hull by more than its room."""
        for name, ball in balls.items():
            low, high = self.ends[name]
            if not (ball > low - rooms[name] and ball < high + rooms[name]):
                return True
        return False


def enclosed_gains(problem: Problem, sigma: float, e: float, sigma_from: float = 0.0, e_from: float = 0.0) -> Balls:
    """Balls of the gains that the loop can have in a region of sigma and e, by name.

    They are K_P, K_I, K_N and the sliding condition's gains, in the conservative form also phi_1/sigma and the slope of
    phi_1 in e.

    Args:
        problem: The certificate's problem.
        sigma: Largest |sigma| [m/s].
        e: Largest |e| [m]; of Table 1's functions only, which depend on e.
        sigma_from: Smallest |sigma| [m/s].
        e_from: Smallest |e| [m].
    """
    if problem["functions"]["kind"] == "vgsta":
        result = table_gains(problem, sigma, e, sigma_from, e_from)
    else:
        result = gains_by_sigma(problem, sigma, sigma_from)
    if problem["form"] == "conservative":  # K_P is a mean over a sample, tau_av belongs to its end
        reach = 1 + result["tau_av"] / arb(problem["sample_time"])
        result["slide_p"] = result["k_p"] * reach
        result["slide_e"] = result.get("k_e", arb(0)) * reach
    return result


def gains_by_sigma(problem: Problem, sigma: float, sigma_from: float) -> Balls:
    """Balls of the gains that depend on sigma alone.

    The interval of |sigma| is halved in |sigma|^(1/2) where a piece's ball exceeds the hull of the gains at points by
    more than a small share of its width.
    """
    pieces = [(sigma_from, sigma)]
    points = PointHull(problem)
    result = Balls()
    remaining = MOST_PIECES
    for end in (sigma_from, sigma):
        points.add(end)
    while pieces:
        for piece in pieces:
            points.add(middle_of(piece))
        rooms = points.rooms()
        remaining -= len(pieces)
        halves = []
        for piece in pieces:
            low, high = piece
            middle = middle_of(piece)
            try:
                balls = gains_at(problem, piece)
            except Rejected:  # too wide a ball, since every point was fine
                require_premise(remaining > 0, "P2: the functions cannot be enclosed in the region")
                halves += [(low, middle), (middle, high)]
                continue
            if remaining > 0 and points.is_exceeded_by(balls, rooms):
                halves += [(low, middle), (middle, high)]
                continue
            for name, ball in balls.items():
                result[name] = result[name].union(ball) if name in result else ball
        pieces = halves
    return result


def enclosed_start_ratio(problem: Problem, *, is_integrated: bool) -> arb:
    """Ball of -v/sigma_0 at the start, or of -q/sigma_0, without d_r and f, for every start of the problem.

    Seen from sigma_hat = sigma_0, the start ``midpoint`` halves the first T_s phi_2.

    Args:
        problem: The certificate's problem.
        is_integrated: Whether the coordinate is q = v - phi_1(sigma_0) in place of v.
    """
    if problem["start"] == "zero":
        return arb(0)
    e, speed = (interval_ball(*pair) for pair in problem["initial"][:2])
    sigma_low, sigma_high = size_ends(speed + arb(problem["l0"]) * e)
    e_low, e_high = size_ends(e)
    gains = enclosed_gains(problem, sigma_high, e_high, sigma_low, e_low)
    ratio = gains["mean"] if is_integrated else arb(0)
    if problem["start"] == "midpoint":
        ratio = ratio + arb(problem["sample_time"]) / 2 * gains["k_i"]
    return ratio


def size_ends(ball: arb) -> tuple[float, float]:
    """Lower and upper bound of |x| over a ball, rounded outwards; the upper one is positive."""
    size = abs(ball)
    low = math.nextafter(float(size.lower()), -math.inf)
    high = math.nextafter(float(size.upper()), math.inf)
    return max(0.0, low), max(high, SMALLEST_REGION)


def with_moving_error(problem: Problem, gains: Balls, error_change: float) -> Balls:
    """The gains of the increments of u_av, where e changes by at most ``error_change`` in a sample.

    In the conservative form phi_1(sigma_k, e_k) - phi_1(sigma_k, e_(k-1)) is sigma_k times a gain, which joins T_s K_I.
    """
    if not depends_on_error(problem):
        return gains
    slope_change = interval_ball(-1.0, 1.0) * abs(gains["by_e"]).upper() * arb(error_change)
    t = arb(problem["sample_time"])
    reach = 1 + gains["tau_av"] / t
    return gains | {"k_i": gains["k_i"] + slope_change / t, "slide_i": gains["slide_i"] + slope_change * reach}


def depends_on_error(problem: Problem) -> bool:
    """Whether phi_1 of the conservative form changes with e."""
    return problem["form"] == "conservative" and bool(problem["functions"].get("kappa_b", 0))


def middle_of(piece: tuple[float, float]) -> float:
    """The middle of an interval of |sigma|, in |sigma|^(1/2)."""
    return (0.5 * (piece[0] ** 0.5 + piece[1] ** 0.5)) ** 2


def gains_at(problem: Problem, size: tuple[float, float]) -> Balls:
    """Balls of the gains that depend on sigma alone, for |sigma| in an interval, by name."""
    constants = constants_of(problem)
    k_o_tau_av, tau_m = functions_at(problem, constants, size)
    t = arb(problem["sample_time"])
    proportional = 1 / k_o_tau_av
    filtered_gain = 1 / constants["k_o"] if "k_o" in constants else constants["tau_av"] * proportional  # tau_av K_P
    integral = proportional / tau_m  # phi_2/sigma in the conservative form, too
    nominal = problem["nominal"]
    pole = 1 / (tau_m * arb(nominal[1])) if nominal and nominal[2] else arb(0)
    mean = {} if problem["functions"]["kind"] == "sta" else {"mean": mean_gain(problem, constants, size, k_o_tau_av)}
    return mean | {
        "k_p": proportional,
        "k_i": integral,
        "k_n": pole,
        "slide_p": proportional + filtered_gain / t,
        "slide_i": t * integral + filtered_gain / tau_m,
        "tau_av": constants["tau_av"] if "tau_av" in constants else k_o_tau_av / constants["k_o"],
    }


def constants_of(problem: Problem) -> Balls:
    """The constants of a problem's functions, by name."""
    return {name: arb(value) for name, value in problem["functions"].items() if name != "kind"}


def functions_at(problem: Problem, c: Balls, size: tuple[float, float]) -> tuple[arb, arb]:
    """k_o tau_av [1] and tau_m [s] for |sigma| in an interval: the rows of Table 2 and of Section V.

    Args:
        problem: The certificate's problem, with the kind of the functions.
        c: Their constants.
        size: Interval of |sigma| [m/s].
    """
    kind = problem["functions"]["kind"]
    low, high = ends_of(size)
    r = low.union(high)
    match kind:
        case "constant":
            k_o_tau_av = c["k_o"] * c["tau_av"]
            tau_m = c["tau_m"]
        case "sta":
            floor = arb(1e-9)
            r = maximum(low, floor).union(maximum(high, floor))
            k_o_tau_av = 2 * r / c["kappa1"]
            tau_m = c["kappa1"] / c["kappa2"] * r
        case "approx_sta_1":
            k_o_tau_av = 2 * (r + c["delta"]) / c["kappa1"]
            tau_m = c["kappa1"] / c["kappa2"] * c["delta"] * enclosed_ratio_to_defect(size, c["delta"])
        case "approx_sta_2":
            k_o_tau_av = 2 * (r + c["delta"]) / c["kappa1"]
            tau_m = c["kappa1"] / c["kappa2"] * (r + c["delta"])
        case "square_root":
            k_o_tau_av = c["kappa_o"] * (r + c["delta_o"]) * c["tau_av"]
            tau_m = c["kappa_m"] * (r + c["delta_m"])
        case "field":
            k_o_tau_av = 2 * r / c["kappa1"] + c["delta"] * c["k_o"]
            tau_m = c["kappa1"] * r / (2 * c["kappa2"]) + c["delta"]
        case _:
            raise Rejected(f"P2: unknown functions '{kind}'")
    require_premise(bool(k_o_tau_av > 0) and bool(tau_m > 0), "P2: the functions are not positive in the region")
    return k_o_tau_av, tau_m


def ends_of(size: tuple[float, float]) -> tuple[arb, arb]:
    """|sigma|^(1/2) at the ends of an interval of |sigma|, which is often a point."""
    root_low = arb(size[0]).sqrt()
    root_high = root_low if size[0] == size[1] else arb(size[1]).sqrt()
    return root_low, root_high


def mean_gain(problem: Problem, c: Balls, size: tuple[float, float], k_o_tau_av: arb) -> arb:
    """phi_1/sigma, the mean of K_P over [0, sigma], for |sigma| in an interval.

    All these functions have k_o tau_av = alpha (r + beta) with r = |sigma|^(1/2), of which the mean is known.
    """
    match problem["functions"]["kind"]:
        case "constant":
            return 1 / k_o_tau_av
        case "approx_sta_1" | "approx_sta_2":
            alpha = 2 / c["kappa1"]
            beta = c["delta"]
        case "square_root":
            alpha = c["kappa_o"] * c["tau_av"]
            beta = c["delta_o"]
        case "field":
            alpha = 2 / c["kappa1"]
            beta = c["delta"] * c["k_o"] * c["kappa1"] / 2
        case kind:
            raise Rejected(f"P2: phi_1 of the functions '{kind}' is not known")
    return 2 / (alpha * beta * enclosed_ratio_to_defect(size, beta))


def enclosed_ratio_to_defect(size: tuple[float, float], scale: arb) -> arb:
    """Enclosure of :func:`ratio_to_defect` of r/scale over an interval of |sigma|, where r = |sigma|^(1/2).

    The ratio rises, so that its values at both ends suffice.
    """
    root_low, root_high = ends_of(size)
    at_low = ratio_to_defect(root_low / scale)
    if size[0] == size[1]:
        return at_low
    return at_low.union(ratio_to_defect(root_high / scale))


def ratio_to_defect(x: arb) -> arb:
    """x^2/(x - ln(1 + x)) for x >= 0, with the limit 2 at 0; it rises, so its values at both ends enclose it."""
    if x < arb("1e-12"):  # 2 + 4 x/3 - ..., within [2, 2 + 2 x]
        return arb(2).union(2 + 2 * x)
    return x * x / (x - x.log1p())
