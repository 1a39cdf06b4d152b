"""Random formulas of signal temporal logic, and their robustness straight from the definitions, in NumPy."""

import numpy as np

SIGNALS = ("e", "u")
T_S = 0.25


def random_formula(rng, depth, budget):
    """A nested tuple; ``budget`` is the number of samples that its intervals may reach ahead."""
    kinds = ["compare"]
    if depth:
        kinds += ["not", "and", "or", "implies", "always", "eventually", "until", "always", "eventually"]
    kind = kinds[rng.integers(len(kinds))] if depth < 4 else kinds[rng.integers(1, len(kinds))]
    if kind == "compare":
        signal = SIGNALS[rng.integers(2)]
        side = [signal, f"abs({signal})", "e + u", f"{signal} * 2 - 0.25"][rng.integers(4)]
        return "compare", side, ("<", ">", "<=", ">=")[rng.integers(4)], round(float(rng.normal()), 3)
    if kind == "not":
        return kind, random_formula(rng, depth - 1, budget)
    if kind in ("and", "or", "implies"):
        return kind, random_formula(rng, depth - 1, budget), random_formula(rng, depth - 1, budget)
    end = int(rng.integers(0, budget // 2 + 1))
    begin = int(rng.integers(0, end + 1))
    count = 2 if kind == "until" else 1
    return kind, begin, end, *(random_formula(rng, depth - 1, budget - end) for _ in range(count))


def text_of(formula, interval=lambda a, b: f"[{a * T_S:g},{b * T_S:g}]"):
    """The formula as text, fully parenthesised."""
    match formula:
        case ("compare", side, sign, bound):
            return f"({side} {sign} {bound})"
        case ("not", inner):
            return f"(not {text_of(inner, interval)})"
        case ("always" | "eventually" as kind, a, b, inner):
            return f"({kind}{interval(a, b)} {text_of(inner, interval)})"
        case ("until", a, b, before, goal):
            return f"({text_of(before, interval)} until{interval(a, b)} {text_of(goal, interval)})"
        case (kind, first, second):
            return f"({text_of(first, interval)} {kind} {text_of(second, interval)})"
    raise ValueError(formula)


def robustness(formula, signals, k):
    """The robustness at sample k, from the definitions."""
    match formula:
        case ("compare", side, sign, bound):
            value = eval(side, {"abs": abs, **{name: column[k] for name, column in signals.items()}})
            return bound - value if "<" in sign else value - bound
        case ("not", inner):
            return -robustness(inner, signals, k)
        case ("and", first, second):
            return min(robustness(first, signals, k), robustness(second, signals, k))
        case ("or", first, second):
            return max(robustness(first, signals, k), robustness(second, signals, k))
        case ("implies", first, second):
            return max(-robustness(first, signals, k), robustness(second, signals, k))
        case ("always", a, b, inner):
            return min(robustness(inner, signals, j) for j in range(k + a, k + b + 1))
        case ("eventually", a, b, inner):
            return max(robustness(inner, signals, j) for j in range(k + a, k + b + 1))
        case ("until", a, b, before, goal):
            found = []
            for j in range(k + a, k + b + 1):
                held = [robustness(before, signals, i) for i in range(k, j)]
                found.append(min([robustness(goal, signals, j), *held]))
            return max(found)
    raise ValueError(formula)


def reach(formula):
    """Samples after k that decide the formula at k."""
    inner = max((reach(part) for part in formula[1:] if isinstance(part, tuple)), default=0)
    return inner + (formula[2] if formula[0] in ("always", "eventually", "until") else 0)


def random_signals(rng, samples):
    """A random walk and noise."""
    return {"e": np.cumsum(rng.normal(0.0, 0.4, samples)), "u": rng.normal(0.0, 1.0, samples)}
