"""Write a certificate's loop in words, with every digit of its numbers, and the verifier's verdict on it."""

from collections.abc import Mapping

from dssc_jax.proofs.verifier.certificate import Interval, Problem
from dssc_jax.proofs.verifier.verdict import ProofVerdict

SIGNAL_NAMES = ("|y_m'|", "|y_m''|", "|y_m'''|")
"""The derivatives of the reference that a problem bounds, in the order of its entry ``reference``."""


def loop_in_words(problem: Problem) -> dict[str, str]:
    """Describe the problem of a well-formed certificate, by label, so that people can compare it with their own loop.

    A certificate does not name units: lengths are in the unit of y, commands in the unit of u, times in seconds.
    """
    return {
        "controller": controller_words(problem),
        "functions": functions_words(problem["functions"]),
        "nominal": nominal_words(problem["nominal"]),
        "plant": plant_words(problem),
        "start": start_words(problem),
        "unmodelled": unmodelled_words(problem),
        "sensor": f"lag of {problem['sensor_lag']} s" if problem["sensor_lag"] else "exact",
        "disturbance": disturbance_words(problem),
        "reference": reference_words(problem),
    }


def verdict_in_words(verdict: ProofVerdict) -> str:
    """A sentence that says whether a certificate is valid: the bounds of |e| that it proves, or why it fails."""
    if not verdict.proved:
        return f"not valid: {verdict.reason}"
    bounds = f"{verdict.largest_error:.4g} and ends within {verdict.error:.4g}"
    return f"valid: |e| never exceeds {bounds}, in the output's unit"


def interval_words(interval: Interval) -> str:
    """Write an interval as ``in [low, high]``, or as ``= number`` if its ends are equal."""
    low, high = interval
    return f"= {low}" if low == high else f"in [{low}, {high}]"


def controller_words(problem: Problem) -> str:
    """Form, T_s, l_0, rho and the predictor's start, in words."""
    rho = "without a bound of the command" if problem["rho"] is None else f"rho = {problem['rho']}"
    period = f"T_s = {problem['sample_time']} s"
    return f"{problem['form']} form, {period}, l_0 = {problem['l0']} 1/s, {rho}, predictor's start {problem['start']}"


def functions_words(functions: Mapping[str, float | str]) -> str:
    """Kind and constants of the state-dependent functions, in words."""
    constants = [f"{name} = {value}" for name, value in functions.items() if name != "kind"]
    return f"{functions['kind']} with {', '.join(constants)}"


def nominal_words(nominal: tuple[float, float, bool] | None) -> str:
    """The nominal control's a_n and k_n, and whether it has its term 1/tau_m, in words."""
    if nominal is None:
        return "none"
    a_n, k_n, has_predictor_term = nominal
    with_or_without = "with" if has_predictor_term else "without"
    return f"a_n = {a_n} 1/s, k_n = {k_n}, {with_or_without} its term 1/tau_m"


def plant_words(problem: Problem) -> str:
    """The intervals of k_p and a_p, the plant's order, and its zero dynamics, in words."""
    intervals = f"k_p {interval_words(problem['k_p'])}, a_p {interval_words(problem['a_p'])} 1/s"
    if not problem["zero_a"]:
        return f"{intervals}, order 2"
    order = 2 + len(problem["zero_a"])
    zeros = f"zero dynamics a = {list(problem['zero_a'])}, c = {list(problem['zero_c'])}"
    return f"{intervals}, order {order}, {zeros}"


def start_words(problem: Problem) -> str:
    """The intervals of the initial state e, e' and eta, in words."""
    names = ["e", "e'", *(f"eta_{i + 1}" for i in range(len(problem["zero_a"])))]
    parts = [f"{name} {interval_words(pair)}" for name, pair in zip(names, problem["initial"], strict=True)]
    return ", ".join(parts)


def unmodelled_words(problem: Problem) -> str:
    """The transfer function G(mu s) with the interval of mu, or the delay, in words."""
    if problem["denominator"]:
        quotient = f"{list(problem['numerator'])}/{list(problem['denominator'])}"
        return f"G(mu s) = {quotient} in rising powers of mu s, mu {interval_words(problem['mu'])} s"
    return f"delay of {problem['delay']} samples" if problem["delay"] else "none"


def disturbance_words(problem: Problem) -> str:
    """The bounds of the disturbance (wind, load), and the gains k_d1 to k_d5 of its state dependence, in words."""
    bounds = f"any (wind, load) with |d| <= {problem['level']} and slope |d'| <= {problem['slope']} 1/s"
    gains = [f"k_d{i} = {k}" for i, k in enumerate(problem["by_state"], 1) if k]
    if not gains:
        return bounds
    return f"{bounds}, besides what depends on the state with {', '.join(gains)}, |y_m| <= {problem['reference_size']}"


def reference_words(problem: Problem) -> str:
    """The bounds of the reference's derivatives, in words."""
    if not any(problem["reference"]):
        return "at rest"
    limits = [f"{name} <= {bound}" for name, bound in zip(SIGNAL_NAMES, problem["reference"], strict=True)]
    return f"any with {', '.join(limits)}"
