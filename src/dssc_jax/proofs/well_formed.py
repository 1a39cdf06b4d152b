"""(P0) What a certificate has to look like before anything in it is computed with: types, shapes, signs."""

import math
from typing import Any

from dssc_jax.proofs.balls import require_premise

CONSTANTS = {
    "constant": ({"k_o", "tau_av", "tau_m"}, False),
    "sta": ({"kappa1", "kappa2"}, True),
    "approx_sta_1": ({"kappa1", "kappa2", "delta"}, True),
    "approx_sta_2": ({"kappa1", "kappa2", "delta"}, True),
    "square_root": ({"kappa_o", "kappa_m", "delta_o", "delta_m", "tau_av"}, False),
    "field": ({"k_o", "kappa1", "kappa2", "delta"}, False),
    "vgsta": (
        {"phi_a", "phi_b", "kappa_a", "kappa_b", "kappa_c", "kappa_d", "epsilon", "gamma", "delta"},
        True,
    ),
}
"""Constants of each row of functions, and whether exactly one of k_o and tau_av belongs to them."""

STARTS = ("zero", "matched", "midpoint")
MAY_VANISH = {"phi_a", "kappa_a", "kappa_b", "kappa_c", "gamma"}
SIGNALS, MIDDLE_COUNT = 5, 5
"""Signals besides the states that a bound belongs to, and gains of a middle loop."""
MOST_DELAY, MOST_PIECES, MOST_DEGREE = 200, 1000, 8
"""Longest delay, in samples, largest number of pieces of a region, and largest degree of a polynomial in 1/mu."""


def require_shape(holds: bool, place: str, rule: str) -> None:
    """Reject a part that breaks a rule."""
    require_premise(holds, f"P0: {place} {rule}")


def require_finite(value: Any, place: str) -> None:
    """Reject what is not a finite number of float64; text and truth values are none."""
    require_shape(type(value) in (int, float), place, "is not a finite number")
    require_shape(abs(value) < math.inf and float(value) == value, place, "is not a finite number")


def require_positive(value: Any, place: str) -> None:
    """Reject what is not a positive finite number."""
    require_finite(value, place)
    require_shape(value > 0, place, "is not positive")


def require_numbers(values: Any, count: int | None, place: str) -> None:
    """Reject what is not a list of so many finite numbers."""
    require_shape(isinstance(values, list | tuple) and count in (None, len(values)), place, "has not its length")
    for value in values:
        require_finite(value, place)


def require_interval(pair: Any, place: str) -> None:
    """Reject what is not an interval."""
    require_numbers(pair, 2, place)
    require_shape(pair[0] <= pair[1], place, "ends before it begins")


def require_problem(problem: Any) -> None:
    """Reject a problem that is no loop of the class."""
    require_shape(isinstance(problem, dict), "problem", "is no table")
    for name in ("sample_time", "l0"):
        require_positive(problem[name], name)
    for name in ("level", "slope"):
        require_finite(problem[name], name)
        require_shape(problem[name] >= 0, name, "is negative")
    for name in ("k_p", "a_p", "mu"):
        require_interval(problem[name], name)
    require_shape(problem["k_p"][0] > 0, "k_p", "is not positive")
    require_unmodelled(problem)
    require_finite(problem["sensor_lag"], "sensor_lag")
    require_shape(problem["sensor_lag"] >= 0, "sensor_lag", "is negative")
    require_numbers(problem["by_state"], 5, "by_state")
    require_shape(all(each >= 0 for each in problem["by_state"]), "by_state", "is negative")
    require_finite(problem["reference_size"], "reference_size")
    require_shape(problem["reference_size"] >= 0, "reference_size", "is negative")
    require_numbers(problem["reference"], 3, "reference")
    require_shape(all(each >= 0 for each in problem["reference"]), "reference", "is negative")
    still = not any(problem["reference"])
    require_shape(still or not (problem["zero_a"] or problem["sensor_lag"]), "reference", "moves, which is not covered")
    require_numbers(problem["zero_a"], None, "zero_a")
    require_numbers(problem["zero_c"], len(problem["zero_a"]), "zero_c")
    require_shape(len(problem["initial"]) == 2 + len(problem["zero_a"]), "initial", "has not its length")
    for pair in problem["initial"]:
        require_interval(pair, "initial")
    require_shape(problem["start"] in STARTS, "start", f"is none of {', '.join(STARTS)}")
    if problem["rho"] is not None:
        require_positive(problem["rho"], "rho")
    if problem["nominal"]:
        a, k, predictor_term = problem["nominal"]
        require_finite(a, "nominal")
        require_positive(k, "nominal")
        require_shape(type(predictor_term) is bool, "nominal", "is not true or false")
    require_functions(problem["functions"], problem["form"])


def require_unmodelled(problem: dict[str, Any]) -> None:
    """Reject a G(mu s) or a delay that the loop cannot have."""
    above, below, delay = problem["numerator"], problem["denominator"], problem["delay"]
    require_numbers(above, None, "numerator")
    require_numbers(below, None, "denominator")
    require_finite(delay, "delay")
    require_shape(0 <= delay <= MOST_DELAY, "delay", f"is not within [0, {MOST_DELAY}]")
    if not below:
        require_shape(not above, "numerator", "has no denominator")
        return
    require_shape(len(below) > 1 and 0 < len(above) <= len(below), "numerator", "is not proper")
    require_shape(above[0] == below[0] != 0, "numerator", "does not begin like the denominator")
    require_shape(below[-1] != 0, "denominator", "ends with 0")
    require_shape(not delay, "delay", "comes with a transfer function")
    require_shape(problem["mu"][0] > 0, "mu", "is not positive")


def require_functions(functions: Any, form: Any) -> None:
    """Reject functions that are no row of the tables, or that the form does not cover."""
    require_shape(isinstance(functions, dict) and functions.get("kind") in CONSTANTS, "functions", "are unknown")
    names, one_factor = CONSTANTS[functions["kind"]]
    given = functions.keys() - {"kind"}
    factors = given & {"k_o", "tau_av"} if one_factor else set()
    require_shape(given - factors == names and len(factors) == one_factor, "functions", "have not their constants")
    for name in given:
        require_finite(functions[name], name)
        require_shape(functions[name] > 0 or (name in MAY_VANISH and functions[name] == 0), name, "is not positive")
    require_shape(form in ("implicit", "conservative"), "form", "is neither implicit nor conservative")
    covered = form == "implicit" or functions["kind"] != "sta"
    require_shape(covered, "functions", "are not covered in the conservative form")


def require_proof(problem: dict[str, Any], proof: Any) -> None:
    """Reject a box and stages of other shapes than the problem's."""
    order = max(len(problem["denominator"]) - 1, math.ceil(problem["delay"])) + 2 * bool(problem["sensor_lag"])
    eta, box = len(problem["zero_a"]), proof["box"]
    n = 4 + eta + order
    require_shape(
        box.keys() == {"k_p", "a_p"} | ({"rate"} if problem["denominator"] else set()), "box", "has not its sides"
    )
    for name, pair in box.items():
        require_interval(pair, f"box.{name}")
        require_shape(name == "a_p" or pair[0] > 0, f"box.{name}", "is not positive")
    require_shape(isinstance(proof["stages"], list | tuple) and bool(proof["stages"]), "stages", "are missing")
    for stage in proof["stages"]:
        for name in ("sigma", "e", "rate"):
            require_positive(stage[name], name)
        for name in ("level", "slope"):
            require_finite(stage[name], name)
            require_shape(stage[name] >= 0, name, "is negative")
        require_shape(len(stage["p"]) == n, "p", "has not its shape")
        for row in stage["p"]:
            require_numbers(row, n, "p")
        if stage["method"] == "small gain":
            require_numbers(stage["gains"], MIDDLE_COUNT, "gains")
            require_numbers(stage["bounds"], SIGNALS + n, "bounds")
            require_shape(all(bound > 0 for bound in stage["bounds"]), "bounds", "are not positive")
        else:
            require_shape(stage["method"] == "invariant set", "method", "is unknown")
            require_numbers(stage["multipliers"], 4 + eta, "multipliers")
            pieces, degree = stage["pieces"], stage["degree"]
            require_shape(type(pieces) is int and 1 <= pieces <= MOST_PIECES, "pieces", "is no number of pieces")
            require_shape(type(degree) is int and 1 <= degree <= MOST_DEGREE, "degree", "is no degree of a polynomial")
