"""The gains of the sampled loop in a region of sigma and e, enclosed in balls: the verifier's own rows of Table 2.

    v+ = v + K_P (sigma - s) + T_s K_I sigma,    K_P = 1/(k_o tau_av),    K_I = K_P/tau_m,    K_N = 1/(k_n tau_m)

The gains have names: ``k_p``, ``k_i``, ``k_n``; ``slide_p`` = K_P (1 + tau_av/T_s) and ``slide_i`` = T_s K_I (1 +
tau_av/T_s), those of the equivalent control; ``mean`` = phi_1/sigma; ``slide_e`` = |d phi_1/d e| (1 + tau_av/T_s);
``by_e`` = |d phi_1/d e|/|sigma|; and ``tau_av`` itself. Table 1's functions are in
:mod:`dssc_jax.proofs.verifier.table_gains`.
"""

import math

from flint import arb

from dssc_jax.proofs.verifier.balls import Balls, Rejected, interval_ball, maximum, require_premise
from dssc_jax.proofs.verifier.certificate import Problem
from dssc_jax.proofs.verifier.table_gains import table_gains

PRECISE = 0.03
"""Largest excess of an enclosure over the hull of the gains at points, as a share of the hull's width."""
ROUNDING = 2.0**-40
"""Excess that rounding needs besides, as a share of the gain."""
SMALLEST_ROOM = 1e-300
"""Excess that is always allowed, so that a gain of 0 can pass."""
MOST_PIECES = 6000
"""Number of pieces of |sigma| after which no further piece is cut."""
SMALLEST_REGION = 1e-12
"""Smallest bound of |sigma| [m/s] and |e| [m] at the start, so that both are positive."""
SizeInterval = tuple[float, float]
"""Lower and upper end of an interval of |sigma| [m/s], which may be a point."""


class PointHull:
    """The smallest interval of each gain that contains the gain's values at some points of |sigma|.

    Every enclosure of a gain contains this interval, and is good enough if it is not much larger.

    Args:
        problem: The certificate's problem, with functions of sigma alone.
    """

    def __init__(self, problem: Problem) -> None:
        """Store the problem, and begin without points."""
        self.problem = problem
        self.ends: dict[str, tuple[float, float]] = {}

    def add(self, size: float) -> None:
        """Extend the intervals by the gains at one |sigma| [m/s]."""
        for name, ball in gains_at(self.problem, (size, size)).items():
            value = float(ball.mid())
            low, high = self.ends.get(name, (math.inf, -math.inf))
            self.ends[name] = (min(low, value), max(high, value))

    def rooms(self) -> dict[str, float]:
        """The largest allowed excess of a ball over the interval of its gain, by the gain's name."""
        return {
            name: PRECISE * (high - low) + ROUNDING * max(abs(low), abs(high)) + SMALLEST_ROOM
            for name, (low, high) in self.ends.items()
        }

    def is_exceeded_by(self, balls: Balls, rooms: dict[str, float]) -> bool:
        """Whether any ball exceeds the interval of its gain by more than the allowed excess.

        Args:
            balls: Ball of each gain, by name.
            rooms: The allowed excess of each gain, by :meth:`rooms`.
        """
        for name, ball in balls.items():
            low, high = self.ends[name]
            fits = ball > low - rooms[name] and ball < high + rooms[name]
            if not fits:
                return True
        return False


def enclosed_gains(problem: Problem, sigma: float, e: float, sigma_from: float = 0.0, e_from: float = 0.0) -> Balls:
    """Balls of the gains that the loop can have in a region of sigma and e, by the names at the module's top.

    In the conservative form K_P is a mean over the sample, whereas tau_av is the value at the sample's end. So the
    balls of K_P and 1 + tau_av/T_s are multiplied in ``slide_p``, as if both were independent; likewise ``slide_e``.

    Args:
        problem: The certificate's problem.
        sigma: Largest |sigma| [m/s].
        e: Largest |e| [m]; only Table 1's functions depend on e.
        sigma_from: Smallest |sigma| [m/s].
        e_from: Smallest |e| [m].

    Raises:
        Rejected: The functions cannot be enclosed in the region, or may not be positive there.
    """
    if problem["functions"]["kind"] == "vgsta":
        gains = table_gains(problem, sigma, e, sigma_from, e_from)
    else:
        gains = gains_by_sigma(problem, sigma, sigma_from)
    if problem["form"] == "conservative":
        reach = 1 + gains["tau_av"] / arb(problem["sample_time"])
        gains["slide_p"] = gains["k_p"] * reach
        gains["slide_e"] = gains.get("k_e", arb(0)) * reach  # k_e = |d phi_1/d e|, which only Table 1's functions have
    return gains


def gains_by_sigma(problem: Problem, sigma: float, sigma_from: float) -> Balls:
    """Balls of the gains of functions of sigma alone, for |sigma| from ``sigma_from`` to ``sigma`` [m/s].

    A piece of |sigma| is halved at its middle in |sigma|^(1/2) if a ball of it exceeds the hull of the gains at points
    by more than a small share of the hull's width.

    Raises:
        Rejected: The functions cannot be enclosed in the region.
    """
    pieces = [(sigma_from, sigma)]
    points = PointHull(problem)
    enclosure = Balls()
    remaining = MOST_PIECES
    for end in (sigma_from, sigma):
        points.add(end)
    while pieces:
        for piece in pieces:
            points.add(middle_of(piece))
        rooms = points.rooms()
        remaining -= len(pieces)
        wide_pieces = []
        for piece in pieces:
            try:
                balls = gains_at(problem, piece)
            except Rejected:  # the piece is too wide, since the functions are positive at every point
                require_premise(remaining > 0, "P2: the functions cannot be enclosed in the region")
                wide_pieces.append(piece)
                continue
            if remaining > 0 and points.is_exceeded_by(balls, rooms):
                wide_pieces.append(piece)
                continue
            for name, ball in balls.items():
                enclosure[name] = enclosure[name].union(ball) if name in enclosure else ball
        pieces = [half for piece in wide_pieces for half in halves_of(piece)]
    return enclosure


def enclosed_start_ratio(problem: Problem, *, is_integrated: bool) -> arb:
    """Ball of -v/sigma_0 before the first sample, for every start of the problem; of -q/sigma_0 if z contains q.

    The share of d_r + f in v is left out. Before the first sample u_av = 0. The start ``zero`` has s = 0, hence v = q =
    0. The others have s = sigma_0, hence q = -phi_1(sigma_0). ``midpoint`` adds only half of the first T_s phi_2, so
    its v and q are lower by (T_s/2) phi_2.

    Args:
        problem: The certificate's problem.
        is_integrated: Whether z contains q = v - phi_1(s) in place of v.
    """
    if problem["start"] == "zero":
        return arb(0)
    errors, speeds, *_ = problem["initial"]  # of e, e' and eta
    e = interval_ball(*errors)
    speed = interval_ball(*speeds)
    sigma_low, sigma_high = size_ends(speed + arb(problem["l0"]) * e)
    e_low, e_high = size_ends(e)
    gains = enclosed_gains(problem, sigma_high, e_high, sigma_low, e_low)
    ratio = gains["mean"] if is_integrated else arb(0)
    if problem["start"] == "midpoint":
        ratio = ratio + arb(problem["sample_time"]) / 2 * gains["k_i"]
    return ratio


def size_ends(ball: arb) -> tuple[float, float]:
    """Lower and upper bound of |x| over a ball, rounded outwards to float64; the upper one is positive."""
    size = abs(ball)
    low = math.nextafter(float(size.lower()), -math.inf)
    high = math.nextafter(float(size.upper()), math.inf)
    return max(0.0, low), max(high, SMALLEST_REGION)


def with_moving_error(problem: Problem, gains: Balls, error_change: float) -> Balls:
    """The gains in v+ = v + K_P (sigma - s) + T_s K_I sigma if phi_1 depends on e, and e changes in a sample.

    phi_1(sigma_k, e_k) - phi_1(sigma_k, e_(k-1)) = theta sigma_k, where |theta| is at most the largest |d phi_1/d e|/
    |sigma| times the change of e. So theta is added to T_s K_I. Where phi_1 does not depend on e, the gains stay as
    they are.

    Args:
        problem: The certificate's problem.
        gains: Balls of the gains without theta.
        error_change: Bound of the change of e in a sample [m].
    """
    if not depends_on_error(problem):
        return gains
    theta = interval_ball(-1.0, 1.0) * abs(gains["by_e"]).upper() * arb(error_change)
    t = arb(problem["sample_time"])
    reach = 1 + gains["tau_av"] / t
    return gains | {"k_i": gains["k_i"] + theta / t, "slide_i": gains["slide_i"] + theta * reach}


def depends_on_error(problem: Problem) -> bool:
    """Whether the loop has a phi_1 that changes with e: Table 1's with kappa_b > 0, in the conservative form."""
    return problem["form"] == "conservative" and bool(problem["functions"].get("kappa_b", 0))


def middle_of(piece: SizeInterval) -> float:
    """The middle of an interval of |sigma| on the scale of |sigma|^(1/2), on which the functions vary most evenly."""
    low, high = piece
    return (0.5 * (low**0.5 + high**0.5)) ** 2


def halves_of(piece: SizeInterval) -> list[SizeInterval]:
    """Cut an interval of |sigma| into two at its middle, :func:`middle_of`."""
    low, high = piece
    middle = middle_of(piece)
    return [(low, middle), (middle, high)]


def gains_at(problem: Problem, size: SizeInterval) -> Balls:
    """Balls of the gains of functions of sigma alone, for |sigma| in an interval, by the names at the module's top.

    ``mean`` is missing for ``sta``, whose phi_1 has an infinite slope at 0.

    Raises:
        Rejected: The interval is so wide that the functions may not be positive in it, or their kind is unknown.
    """
    constants = constants_of(problem)
    k_o_tau_av, tau_m = functions_at(problem, constants, size)
    t = arb(problem["sample_time"])
    proportional = 1 / k_o_tau_av  # K_P
    integral = proportional / tau_m  # K_I, and phi_2/sigma of the conservative form
    if "k_o" in constants:
        tau_av = k_o_tau_av / constants["k_o"]
        averaging_gain = 1 / constants["k_o"]  # tau_av K_P
    else:
        tau_av = constants["tau_av"]
        averaging_gain = tau_av * proportional
    gains = {
        "k_p": proportional,
        "k_i": integral,
        "k_n": arb(0),
        "slide_p": proportional + averaging_gain / t,
        "slide_i": t * integral + averaging_gain / tau_m,
        "tau_av": tau_av,
    }
    if problem["nominal"]:
        _, k_n, has_predictor_term = problem["nominal"]
        if has_predictor_term:
            gains["k_n"] = 1 / (tau_m * arb(k_n))
    if problem["functions"]["kind"] != "sta":  # its phi_1 has an infinite slope at 0
        gains["mean"] = mean_gain(problem, constants, size, k_o_tau_av)
    return gains


def constants_of(problem: Problem) -> Balls:
    """The constants of a problem's functions as exact balls, by name."""
    return {name: arb(value) for name, value in problem["functions"].items() if name != "kind"}


def functions_at(problem: Problem, c: Balls, size: SizeInterval) -> tuple[arb, arb]:
    """Balls of k_o tau_av [1] and tau_m [s] for |sigma| in an interval: the rows of Table 2 and of Section V.

    Args:
        problem: The certificate's problem, with the kind of the functions.
        c: Constants of the functions, by the names of the article.
        size: Interval of |sigma| [m/s].

    Raises:
        Rejected: The functions are unknown, or may not be positive in the interval.
    """
    kind = problem["functions"]["kind"]
    low, high = root_ends(size)
    r = low.union(high)  # |sigma|^(1/2)
    match kind:
        case "constant":
            k_o_tau_av = c["k_o"] * c["tau_av"]
            tau_m = c["tau_m"]
        case "sta":
            floor = arb(1e-9)  # the controller's own floor of |sigma|^(1/2) [(m/s)^(1/2)]
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


def root_ends(size: SizeInterval) -> tuple[arb, arb]:
    """Balls of |sigma|^(1/2) at both ends of an interval of |sigma|; the same ball twice if the ends are equal."""
    low, high = size
    root_low = arb(low).sqrt()
    return root_low, root_low if low == high else arb(high).sqrt()


def mean_gain(problem: Problem, c: Balls, size: SizeInterval, k_o_tau_av: arb) -> arb:
    """Ball of phi_1/sigma, the mean of K_P over [0, sigma], for |sigma| in an interval.

    All these functions have k_o tau_av = alpha (r + beta) with r = |sigma|^(1/2). So K_P = 1/(alpha (r + beta)), and
    its mean is 2 (r - beta ln(1 + r/beta))/(alpha r^2).

    Args:
        problem: The certificate's problem, with the kind of the functions.
        c: Constants of the functions, by the names of the article.
        size: Interval of |sigma| [m/s].
        k_o_tau_av: Ball of k_o tau_av; only constant functions need it.

    Raises:
        Rejected: No formula of phi_1 is known for the kind of the functions.
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


def enclosed_ratio_to_defect(size: SizeInterval, scale: arb) -> arb:
    """Ball of x^2/(x - ln(1 + x)) at x = r/scale over an interval of |sigma|, where r = |sigma|^(1/2).

    The ratio rises with x, so that its values at both ends suffice.

    Args:
        size: Interval of |sigma| [m/s].
        scale: A positive number in the unit of r.
    """
    low, high = size
    root_low, root_high = root_ends(size)
    at_low = ratio_to_defect(root_low / scale)
    return at_low if low == high else at_low.union(ratio_to_defect(root_high / scale))


def ratio_to_defect(x: arb) -> arb:
    """Ball of x^2/(x - ln(1 + x)) for x >= 0, with the limit 2 at 0."""
    if x < arb("1e-12"):  # where the difference cancels; 2 + 4 x/3 - ... lies within [2, 2 + 2 x]
        return arb(2).union(2 + 2 * x)
    return x * x / (x - x.log1p())
