"""(P0) What a certificate has to look like before anything in it is computed with: entries, types, shapes, signs."""

import math
import sys
from typing import Any

from dssc_jax.proofs.verifier.balls import require_premise

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
CERTIFICATE_ENTRIES = {"version", "complete", "problem", "proofs"}
PROBLEM_ENTRIES = {
    "sample_time",
    "l0",
    "form",
    "functions",
    "rho",
    "nominal",
    "k_p",
    "a_p",
    "zero_a",
    "zero_c",
    "numerator",
    "denominator",
    "mu",
    "delay",
    "sensor_lag",
    "level",
    "slope",
    "reference",
    "initial",
    "start",
    "by_state",
    "reference_size",
}
EVERY_STAGE = {"sigma", "e", "level", "slope", "rate", "p", "method"}
STAGE_ENTRIES = {
    "small gain": EVERY_STAGE | {"gains", "bounds"},
    "invariant set": EVERY_STAGE | {"pieces", "degree", "multipliers", "coordinate", "moved"},
}
"""Entries of a certificate, of its problem, and of a stage by its method. All of them are needed, and no other."""
FORMS = ("implicit", "conservative")
COORDINATES = ("u_av", "phi_1")
STARTS = ("zero", "matched", "midpoint")
MAY_VANISH = {"phi_a", "kappa_a", "kappa_b", "kappa_c", "gamma"}
SIGNALS, MIDDLE_COUNT = 5, 5
"""Signals besides the states that a bound belongs to, and gains of a middle loop."""
MOST_DELAY, MOST_ORDER, MOST_WIDE, MOST_PIECES, MOST_DEGREE = 200, 30, 10, 1000, 8
"""Longest delay, in samples, largest order of G or of the zero dynamics, largest number of initial states with an
interval, of pieces of a region, and largest degree of a polynomial in 1/mu."""


def require_shape(holds: bool, place: str, rule: str) -> None:
    """Reject a part that breaks a rule."""
    require_premise(holds, f"P0: {place} {rule}")


def require_entries(table: Any, names: set[str], place: str) -> None:
    """Reject what is not a table with exactly these entries."""
    require_shape(isinstance(table, dict), place, "is no table")
    missing, unknown = sorted(names - table.keys()), sorted(map(str, table.keys() - names))
    require_shape(not missing, place, f"has no entry {', '.join(missing)}")
    require_shape(not unknown, place, f"has an unknown entry {', '.join(unknown)[:80]}")


def require_list(values: Any, count: int | None, place: str) -> None:
    """Reject what is not a list of so many items."""
    require_shape(isinstance(values, list | tuple), place, "is no list")
    require_shape(count in (None, len(values)), place, f"has {len(values)} items in place of {count}")


def require_finite(value: Any, place: str) -> None:
    """Reject what is not a finite number of float64; text and truth values are none."""
    require_shape(type(value) in (int, float), place, "is not a finite number")
    require_shape(abs(value) <= sys.float_info.max and float(value) == value, place, "is not a finite number")


def require_positive(value: Any, place: str) -> None:
    """Reject what is not a positive finite number."""
    require_finite(value, place)
    require_shape(value > 0, place, "is not positive")


def require_not_negative(value: Any, place: str) -> None:
    """Reject what is not a finite number of at least 0."""
    require_finite(value, place)
    require_shape(value >= 0, place, "is negative")


def require_numbers(values: Any, count: int | None, place: str) -> None:
    """Reject what is not a list of so many finite numbers."""
    require_list(values, count, place)
    for value in values:
        require_finite(value, place)


def require_sizes(values: Any, count: int, place: str) -> None:
    """Reject what is not a list of so many finite numbers of at least 0."""
    require_numbers(values, count, place)
    require_shape(all(value >= 0 for value in values), place, "is negative")


def require_interval(pair: Any, place: str) -> None:
    """Reject what is not an interval."""
    require_numbers(pair, 2, place)
    require_shape(pair[0] <= pair[1], place, "ends before it begins")


def require_certificate(certificate: Any) -> None:
    """Reject a certificate with other parts than a problem, its proofs, and what they claim."""
    require_entries(certificate, CERTIFICATE_ENTRIES, "the certificate")
    require_shape(type(certificate["complete"]) is bool, "complete", "is not true or false")
    require_problem(certificate["problem"])
    require_list(certificate["proofs"], None, "proofs")
    for proof in certificate["proofs"]:
        require_proof(certificate["problem"], proof)


def require_problem(problem: Any) -> None:
    """Reject a problem that is no loop of the class."""
    require_entries(problem, PROBLEM_ENTRIES, "problem")
    for name in ("sample_time", "l0"):
        require_positive(problem[name], name)
    for name in ("level", "slope", "sensor_lag", "reference_size"):
        require_not_negative(problem[name], name)
    for name in ("k_p", "a_p", "mu"):
        require_interval(problem[name], name)
    require_shape(problem["k_p"][0] > 0, "k_p", "is not positive")
    require_unmodelled(problem)
    require_sizes(problem["by_state"], 5, "by_state")
    require_sizes(problem["reference"], 3, "reference")
    by_state = any(problem["by_state"])
    require_shape(by_state or problem["reference_size"] == 0, "reference_size", "acts on no disturbance")
    require_numbers(problem["zero_a"], None, "zero_a")
    order = len(problem["zero_a"])
    require_shape(order <= MOST_ORDER, "zero_a", f"has more than {MOST_ORDER} items")
    require_numbers(problem["zero_c"], order, "zero_c")
    still = not any(problem["reference"])
    require_shape(still or not (order or problem["sensor_lag"]), "reference", "moves, which is not covered")
    require_list(problem["initial"], 2 + order, "initial")
    for pair in problem["initial"]:
        require_interval(pair, "initial")
    wide = sum(low < high for low, high in problem["initial"])
    require_shape(wide <= MOST_WIDE, "initial", f"has more than {MOST_WIDE} intervals")
    require_shape(problem["start"] in STARTS, "start", f"is none of {', '.join(STARTS)}")
    if problem["rho"] is not None:
        require_positive(problem["rho"], "rho")
    if problem["nominal"] is not None:
        require_list(problem["nominal"], 3, "nominal")
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
        require_shape(not any(problem["mu"]), "mu", "belongs to no transfer function")
        return
    require_shape(len(below) <= MOST_ORDER, "denominator", f"has more than {MOST_ORDER} items")
    require_shape(len(below) > 1 and 0 < len(above) <= len(below), "numerator", "is not proper")
    require_shape(above[0] == below[0] != 0, "numerator", "does not begin like the denominator")
    require_shape(below[-1] != 0, "denominator", "ends with 0")
    require_shape(not delay, "delay", "comes with a transfer function")
    require_shape(problem["mu"][0] > 0, "mu", "is not positive")


def require_functions(functions: Any, form: Any) -> None:
    """Reject functions that are no row of the tables, or that the form does not cover."""
    require_shape(isinstance(functions, dict), "functions", "is no table")
    kind = functions.get("kind")
    require_shape(isinstance(kind, str) and kind in CONSTANTS, "functions", "are unknown")
    names, one_factor = CONSTANTS[kind]
    factors = functions.keys() & {"k_o", "tau_av"} if one_factor else set()
    require_shape(len(factors) == one_factor, "functions", "need one of k_o and tau_av")
    require_entries(functions, names | factors | {"kind"}, "functions")
    for name in names | factors:
        require_finite(functions[name], name)
        require_shape(functions[name] > 0 or (name in MAY_VANISH and functions[name] == 0), name, "is not positive")
    require_shape(form in FORMS, "form", "is neither implicit nor conservative")
    require_shape(form == "implicit" or kind != "sta", "functions", "are not covered in the conservative form")


def require_proof(problem: dict[str, Any], proof: Any) -> None:
    """Reject a box and stages of other shapes than the problem's."""
    require_entries(proof, {"box", "stages"}, "a proof")
    require_entries(proof["box"], {"k_p", "a_p"} | ({"rate"} if problem["denominator"] else set()), "box")
    for name, pair in proof["box"].items():
        require_interval(pair, f"box.{name}")
        require_shape(name == "a_p" or pair[0] > 0, f"box.{name}", "is not positive")
    require_list(proof["stages"], None, "stages")
    require_shape(bool(proof["stages"]), "stages", "are missing")
    for stage in proof["stages"]:
        require_stage(problem, stage)


def require_stage(problem: dict[str, Any], stage: Any) -> None:
    """Reject a stage of another shape than the problem's."""
    order = max(len(problem["denominator"]) - 1, math.ceil(problem["delay"])) + 2 * bool(problem["sensor_lag"])
    eta = len(problem["zero_a"])
    n = 4 + eta + order
    require_shape(isinstance(stage, dict), "a stage", "is no table")
    method = stage.get("method")
    require_shape(isinstance(method, str) and method in STAGE_ENTRIES, "method", "is unknown")
    require_entries(stage, STAGE_ENTRIES[method], "a stage")
    for name in ("sigma", "e", "rate"):
        require_positive(stage[name], name)
    for name in ("level", "slope"):
        require_not_negative(stage[name], name)
    require_symmetric(stage["p"], n, "p")
    if method == "small gain":
        require_numbers(stage["gains"], MIDDLE_COUNT, "gains")
        require_numbers(stage["bounds"], SIGNALS + n, "bounds")
        require_shape(all(bound > 0 for bound in stage["bounds"]), "bounds", "are not positive")
        return
    require_numbers(stage["multipliers"], 4 + eta, "multipliers")
    require_not_negative(stage["moved"], "moved")
    require_shape(stage["coordinate"] in COORDINATES, "coordinate", f"is none of {', '.join(COORDINATES)}")
    fits = stage["coordinate"] == "u_av" or problem["form"] == "conservative"
    require_shape(fits, "coordinate", "does not belong to the form")
    pieces, degree = stage["pieces"], stage["degree"]
    require_shape(type(pieces) is int and 1 <= pieces <= MOST_PIECES, "pieces", "is no number of pieces")
    require_shape(type(degree) is int and 1 <= degree <= MOST_DEGREE, "degree", "is no degree of a polynomial")


def require_symmetric(rows: Any, n: int, place: str) -> None:
    """Reject what is not a symmetric matrix of finite numbers, (n, n)."""
    require_list(rows, n, place)
    for row in rows:
        require_numbers(row, n, place)
    symmetric = all(rows[i][j] == rows[j][i] for i in range(n) for j in range(i))
    require_shape(symmetric, place, "is not symmetric")
