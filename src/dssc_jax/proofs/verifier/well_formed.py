"""(P0) The form of a certificate: its entries, types, shapes and signs are checked before anything is computed.

Most functions take a value of the file that was not checked before, and raise ``Rejected`` if the value breaks a
rule. An argument ``place`` names the entry in the message.
"""

import math
import sys
from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from typing import Any, cast

from dssc_jax.proofs.verifier.balls import Rejected, require_premise
from dssc_jax.proofs.verifier.certificate import (
    BoxProof,
    Certificate,
    Interval,
    InvariantStage,
    Problem,
    SmallGainStage,
)

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
"""For each row of functions: the names of its constants, and whether one of k_o and tau_av joins them."""
SMALL_GAIN = "small gain"
"""Method whose stages are bounds that imply themselves."""
INVARIANT_SET = "invariant set"
"""Method whose stages are sets {z'Pz <= 1}."""
STAGE_TYPES = {SMALL_GAIN: SmallGainStage, INVARIANT_SET: InvariantStage}
"""Type of a stage, by its method."""
FORMS = ("implicit", "conservative")
"""Sampled forms of DSSC."""
COORDINATES = ("u_av", "phi_1")
"""Integrator state in z: v = u_av, or q = v - phi_1(s)."""
STARTS = ("zero", "matched", "midpoint")
"""Starts of the predictor."""
KNOWN_INTEGRALS = {"constant", "approx_sta_1", "approx_sta_2", "square_root", "field"}
"""Functions of sigma alone whose integral phi_1 is known."""
MAY_VANISH = {"phi_a", "kappa_a", "kappa_b", "kappa_c", "gamma"}
"""Constants that may be 0; all others are positive."""
SIGNALS = 5
"""Number of signals, besides the states, that a stage of the method "small gain" bounds."""
MIDDLE_COUNT = 5
"""Number of gains of a middle loop."""
MOST_DELAY = 200
"""Longest delay, in samples."""
MOST_ORDER = 30
"""Largest order of G or of the zero dynamics."""
MOST_WIDE = 10
"""Largest number of initial states with an interval, since a set has to hold all corners of these intervals."""
MOST_PIECES = 1000
"""Largest number of pieces of a region."""
MOST_DEGREE = 8
"""Largest degree of the polynomial in 1/mu."""


def require_shape(holds: bool, place: str, rule: str) -> None:
    """Check a rule of (P0): reject the certificate unless it holds.

    Args:
        holds: Whether the rule holds.
        place: Name of the entry, for the message.
        rule: What the entry does wrong, for the message.
    """
    require_premise(holds, f"P0: {place} {rule}")


def require_entries(table: object, names: AbstractSet[str], place: str) -> dict[str, object]:
    """Return a table that has exactly the entries of some names; reject anything else.

    Args:
        table: Any value.
        names: Names of the entries.
        place: Name of the table, for the message.
    """
    if not isinstance(table, dict):
        raise Rejected(f"P0: {place} is no table")
    missing = sorted(names - table.keys())
    unknown = sorted(map(str, table.keys() - names))
    require_shape(not missing, place, f"has no entry {', '.join(missing)}")
    require_shape(not unknown, place, f"has an unknown entry {', '.join(unknown)[:80]}")
    return table


def require_list(values: object, count: int | None, place: str) -> Sequence[object]:
    """Return a list of ``count`` items; None allows any number. Reject anything else."""
    if not isinstance(values, list | tuple):
        raise Rejected(f"P0: {place} is no list")
    require_shape(count in (None, len(values)), place, f"has {len(values)} items in place of {count}")
    return values


def require_finite(value: object, place: str) -> float:
    """Return a finite number of float64; reject anything else, also text and truth values."""
    if type(value) is not int and type(value) is not float:
        raise Rejected(f"P0: {place} is not a finite number")
    require_shape(abs(value) <= sys.float_info.max and float(value) == value, place, "is not a finite number")
    return value


def require_positive(value: object, place: str) -> None:
    """Reject anything but a positive finite number."""
    require_shape(require_finite(value, place) > 0, place, "is not positive")


def require_not_negative(value: object, place: str) -> None:
    """Reject anything but a finite number of at least 0."""
    require_shape(require_finite(value, place) >= 0, place, "is negative")


def require_numbers(values: object, count: int | None, place: str) -> list[float]:
    """Return a list of ``count`` finite numbers; None allows any number. Reject anything else."""
    return [require_finite(value, place) for value in require_list(values, count, place)]


def require_sizes(values: object, count: int, place: str) -> None:
    """Reject anything but a list of ``count`` finite numbers of at least 0."""
    require_shape(all(value >= 0 for value in require_numbers(values, count, place)), place, "is negative")


def require_interval(interval: object, place: str) -> Interval:
    """Return an interval [low, high] of finite numbers; reject anything else."""
    low, high = require_numbers(interval, 2, place)
    require_shape(low <= high, place, "ends before it begins")
    return low, high


def require_certificate(content: object) -> Certificate:
    """Return the content of a file as a certificate if all of its parts have the right form; reject anything else.

    The version is not checked here; :func:`dssc_jax.proofs.prove.check_certificate` does that.
    """
    certificate = require_entries(content, Certificate.__required_keys__, "the certificate")
    require_shape(type(certificate["complete"]) is bool, "complete", "is not true or false")
    problem = require_problem(certificate["problem"])
    for proof in require_list(certificate["proofs"], None, "proofs"):
        require_proof(problem, proof)
    return cast(Certificate, content)


def require_problem(content: object) -> Problem:
    """Return a table as the problem of a loop that the theorem covers; reject anything else."""
    problem: dict[str, Any] = require_entries(content, Problem.__required_keys__, "problem")
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
    depends_on_state = any(problem["by_state"])
    require_shape(depends_on_state or problem["reference_size"] == 0, "reference_size", "acts on no disturbance")
    order = len(require_numbers(problem["zero_a"], None, "zero_a"))
    require_shape(order <= MOST_ORDER, "zero_a", f"has more than {MOST_ORDER} items")
    require_numbers(problem["zero_c"], order, "zero_c")
    if order or problem["sensor_lag"]:
        require_shape(not any(problem["reference"]), "reference", "moves, which is not covered")
    initial = require_list(problem["initial"], 2 + order, "initial")
    intervals = [require_interval(interval, "initial") for interval in initial]
    wide_count = sum(low < high for low, high in intervals)
    require_shape(wide_count <= MOST_WIDE, "initial", f"has more than {MOST_WIDE} intervals")
    require_shape(problem["start"] in STARTS, "start", f"is none of {', '.join(STARTS)}")
    if problem["rho"] is not None:
        require_positive(problem["rho"], "rho")
    require_nominal(problem["nominal"], "nominal")
    require_functions(problem["functions"], problem["form"])
    return cast(Problem, content)


def require_nominal(content: object, place: str) -> None:
    """Reject anything but None or a list of a_n, k_n > 0 and a truth value: whether u_n has its term 1/tau_m."""
    if content is None:
        return
    a_n, k_n, has_predictor_term = require_list(content, 3, place)
    require_finite(a_n, place)
    require_positive(k_n, place)
    require_shape(type(has_predictor_term) is bool, place, "is not true or false")


def require_unmodelled(problem: dict[str, Any]) -> None:
    """Reject a G(mu s) that is not proper or lacks G(0) = 1, a delay out of range, and a G(mu s) with a delay."""
    numerator = require_numbers(problem["numerator"], None, "numerator")
    denominator = require_numbers(problem["denominator"], None, "denominator")
    delay = require_finite(problem["delay"], "delay")
    require_shape(0 <= delay <= MOST_DELAY, "delay", f"is not within [0, {MOST_DELAY}]")
    if not denominator:
        require_shape(not numerator, "numerator", "has no denominator")
        require_shape(not any(problem["mu"]), "mu", "belongs to no transfer function")
        return
    require_shape(len(denominator) <= MOST_ORDER, "denominator", f"has more than {MOST_ORDER} items")
    require_shape(len(denominator) > 1 and 0 < len(numerator) <= len(denominator), "numerator", "is not proper")
    require_shape(numerator[0] == denominator[0] != 0, "numerator", "does not begin like the denominator")
    require_shape(denominator[-1] != 0, "denominator", "ends with 0")
    require_shape(not delay, "delay", "comes with a transfer function")
    require_shape(problem["mu"][0] > 0, "mu", "is not positive")


def require_functions(content: object, form: object) -> None:
    """Reject functions of an unknown kind, with wrong constants, or not covered in the loop's sampled form."""
    if not isinstance(content, dict):
        raise Rejected("P0: functions is no table")
    kind = content.get("kind")
    if not isinstance(kind, str) or kind not in CONSTANTS:
        raise Rejected("P0: functions are unknown")
    names, needs_factor = CONSTANTS[kind]
    factors = content.keys() & {"k_o", "tau_av"} if needs_factor else set()
    require_shape(not needs_factor or len(factors) == 1, "functions", "need one of k_o and tau_av")
    functions = require_entries(content, names | factors | {"kind"}, "functions")
    for name in names | factors:
        value = require_finite(functions[name], name)
        require_shape(value > 0 or (name in MAY_VANISH and value == 0), name, "is not positive")
    require_shape(form in FORMS, "form", "is neither implicit nor conservative")
    require_shape(form == "implicit" or kind != "sta", "functions", "are not covered in the conservative form")


def require_proof(problem: Problem, content: object) -> BoxProof:
    """Return a table as the proof of a box if its intervals and stages fit the problem; reject anything else."""
    proof = require_entries(content, BoxProof.__required_keys__, "a proof")
    names = {"k_p", "a_p", "rate"} if problem["denominator"] else {"k_p", "a_p"}
    for name, interval in require_entries(proof["box"], names, "box").items():
        low, _ = require_interval(interval, f"box.{name}")
        require_shape(name == "a_p" or low > 0, f"box.{name}", "is not positive")
    stages = require_list(proof["stages"], None, "stages")
    require_shape(bool(stages), "stages", "are missing")
    for stage in stages:
        require_stage(problem, stage)
    return cast(BoxProof, content)


def require_stage(problem: Problem, content: object) -> None:
    """Reject a stage whose entries are not those of its method, or whose P and bounds do not fit the problem's z.

    z contains e and e', eta, zeta, the memory of a sensor's lag (of y and y'), v and s.
    """
    eta = len(problem["zero_a"])
    zeta = max(len(problem["denominator"]) - 1, math.ceil(problem["delay"]))
    memory = 2 if problem["sensor_lag"] else 0
    n = 2 + eta + zeta + memory + 2
    if not isinstance(content, dict):
        raise Rejected("P0: a stage is no table")
    method = content.get("method")
    if not isinstance(method, str) or method not in STAGE_TYPES:
        raise Rejected("P0: method is unknown")
    stage: dict[str, Any] = require_entries(content, STAGE_TYPES[method].__required_keys__, "a stage")
    for name in ("sigma", "e", "rate"):
        require_positive(stage[name], name)
    for name in ("level", "slope"):
        require_not_negative(stage[name], name)
    require_symmetric(stage["p"], n, "p")
    require_shape(stage["coordinate"] in COORDINATES, "coordinate", f"is none of {', '.join(COORDINATES)}")
    if method == SMALL_GAIN:
        require_small_gain_entries(problem, stage, SIGNALS + n)
    else:
        require_set_entries(problem, stage, inputs=4 + eta)  # changes of d_r + f and of f; theta along e, e' and eta


def require_small_gain_entries(problem: Problem, stage: dict[str, Any], count: int) -> None:
    """Reject entries that a stage of the method "small gain" cannot have.

    Args:
        problem: The problem, with the form and the functions.
        stage: The stage.
        count: Number of bounds that the stage must have, one for each signal and each state.
    """
    is_conservative = problem["form"] == "conservative"
    if stage["coordinate"] == "phi_1":
        is_allowed = is_conservative or problem["functions"]["kind"] in KNOWN_INTEGRALS
    else:
        is_allowed = not is_conservative
    require_shape(is_allowed, "coordinate", "does not belong to form and functions")
    require_positive(stage["change"], "change")
    require_numbers(stage["gains"], MIDDLE_COUNT, "gains")
    bounds = require_numbers(stage["bounds"], count, "bounds")
    require_shape(all(bound > 0 for bound in bounds), "bounds", "are not positive")


def require_set_entries(problem: Problem, stage: dict[str, Any], inputs: int) -> None:
    """Reject entries that a stage of the method "invariant set" cannot have.

    Args:
        problem: The problem, with the form.
        stage: The stage.
        inputs: Number of the loop's inputs, each of which needs a multiplier.
    """
    require_numbers(stage["multipliers"], inputs, "multipliers")
    require_not_negative(stage["moved"], "moved")
    is_allowed = stage["coordinate"] == "u_av" or problem["form"] == "conservative"
    require_shape(is_allowed, "coordinate", "does not belong to the form")
    require_count(stage["pieces"], MOST_PIECES, "pieces", "is no number of pieces")
    require_count(stage["degree"], MOST_DEGREE, "degree", "is no degree of a polynomial")


def require_count(value: object, limit: int, place: str, rule: str) -> None:
    """Reject anything but an integer from 1 to a limit."""
    require_shape(type(value) is int and 1 <= value <= limit, place, rule)


def require_symmetric(content: object, n: int, place: str) -> None:
    """Reject anything but a symmetric matrix of finite numbers, shape (n, n), as a list of rows."""
    rows = [require_numbers(row, n, place) for row in require_list(content, n, place)]
    is_symmetric = all(rows[i][j] == rows[j][i] for i in range(n) for j in range(i))
    require_shape(is_symmetric, place, "is not symmetric")
