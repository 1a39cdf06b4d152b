"""The language of expressions: values, interval ranges and refusals, against Python's own evaluation."""

import math
import random
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dssc_jax.lanes import compile as compile_lanes
from dssc_jax.study.expressions import evaluate_numbers, names_of, parse_expression
from dssc_jax.study.parameters import ParameterTable

PYTHON = {name: getattr(math, name) for name in ("sqrt", "exp", "log", "sin", "cos", "pi")} | {"min": min, "max": max}
NAMES = ("a", "b2", "R_load", "w0")
PROGRAMS = 200


def written(rng: random.Random, depth: int) -> str:
    """A random expression, as somebody might write it."""
    if depth == 0 or rng.random() < 0.15:
        return rng.choice([*NAMES, "pi", "2", "0.5", "1e-3", "3.25E+1", ".75", "7."])
    match rng.randrange(8):
        case 0 | 1 | 2:
            return f"{written(rng, depth - 1)} {rng.choice('+-*/')} {written(rng, depth - 1)}"
        case 3:
            return f"({written(rng, depth - 1)}){rng.choice(['**2', '**-1', '**0.5', '**3', ' ** b2'])}"
        case 4:
            return f"{rng.choice(['-', '+', '--', '-+'])}{written(rng, depth - 1)}"
        case 5:
            return f"{rng.choice(['sin', 'cos', 'exp', 'log', 'sqrt'])}({written(rng, depth - 1)})"
        case 6:
            arguments = ", ".join(written(rng, depth - 1) for _ in range(rng.randint(2, 4)))
            return f"{rng.choice(['min', 'max'])}({arguments})"
        case _:
            return f"({written(rng, depth - 1)})"


def by_python(text: str, values: dict[str, float]) -> float:
    """The value by Python itself; NaN where Python raises an error or leaves the real numbers."""
    try:
        value = eval(text, {"__builtins__": {}}, PYTHON | values)
    except (ZeroDivisionError, OverflowError, ValueError, TypeError):  # of complex numbers
        return math.nan
    return value if isinstance(value, int | float) else math.nan


def programs() -> list[str]:
    """Random expressions with a value at some point."""
    rng = random.Random(41)
    values = {"a": 1.7, "b2": 0.3, "R_load": 12.5, "w0": 2.25}
    found: list[str] = []
    while len(found) < PROGRAMS:
        text = written(rng, 4)
        if len(text) < 300 and math.isfinite(by_python(text, values)):
            found.append(text)
    return found


@pytest.mark.parametrize("values", [(1.7, 0.3, 12.5, 2.25), (0.2, 4.0, 1e-5, 31.0), (-1.5, 2.0, -0.7, 0.0)])
def test_values_are_those_of_python(values):
    point = dict(zip(NAMES, values, strict=True))
    finite = 0
    for text in programs():
        expected = by_python(text, point)
        tree = parse_expression(f"={text}")
        found = evaluate_numbers(tree, point.__getitem__)
        assert isinstance(found, float)
        assert set(names_of(tree)) == set(NAMES) & set(re.findall(r"\w+", text))
        if math.isfinite(expected):
            finite += 1
            assert found == pytest.approx(expected, rel=1e-13, abs=1e-300), text
        arrays = {name: np.full(3, value) for name, value in point.items()}
        np.testing.assert_array_equal(np.full(3, found), np.broadcast_to(evaluate_numbers(tree, arrays.__getitem__), 3))
    assert finite > 0.4 * PROGRAMS


def test_traced_values_are_those_of_python():
    point = {"a": 1.7, "b2": 0.3, "R_load": 12.5, "w0": 2.25}
    texts = programs()
    trees = [parse_expression(f"={text}") for text in texts]
    expected = np.array([by_python(text, point) for text in texts])

    def all_values(values: dict[str, jax.Array]) -> jax.Array:
        return jnp.stack([jnp.asarray(evaluate_numbers(tree, values.__getitem__)) for tree in trees])

    with jax.enable_x64(True):
        found = jax.jit(all_values)(point)
    np.testing.assert_allclose(found, expected, rtol=1e-11)


def test_lanes_have_every_operation():
    text = "=sqrt(a)*exp(-b/10) + log(a)/b - sin(a)**2*cos(b)**-3 + min(a, b, 2)*max(-a, 0.1)*a**b + (-a)**3 + pi"
    tree = parse_expression(text)
    rng = np.random.default_rng(0)
    columns = {"a": rng.uniform(0.1, 9.0, 64), "b": rng.uniform(0.5, 3.0, 64)}

    def lane(values: dict[str, jax.Array]) -> jax.Array:
        return jnp.asarray(evaluate_numbers(tree, values.__getitem__))

    with jax.enable_x64(True):
        example = {name: column[0] for name, column in columns.items()}
        found = compile_lanes(lane, example)(columns)
    expected = [by_python(text[1:], {"a": a, "b": b}) for a, b in zip(*columns.values(), strict=True)]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("=1/(L*C", "'=1/(L*C' is no expression: '(' was never closed"),
        ("=", "'=' is no expression: invalid syntax"),
        ("=L C", "is no expression: invalid syntax"),
        ("=L^2", "'L^2' holds '^'; a power is written **"),
        ("=L//2", "'L//2' is not admissible in an expression, which may hold numbers, parameters, + - * / **"),
        ("=L if C else R", "'L if C else R' is not admissible"),
        ("=sqr(L)", "'sqr' is no function of expressions; did you mean 'sqrt'?"),
        ("=__import__('os')", "'__import__' is no function of expressions"),
        ("=L.real", "'L.real' is not admissible"),
        ("=(lambda: 1)()", "is not admissible"),
        ("=sqrt(L, 2)", "sqrt takes one argument, got 2"),
        ("=max(L)", "max takes two or more arguments, got 1"),
        ("=max(L, key=C)", "is not admissible"),
        ("=max(*L, 1)", "'*L' is not admissible"),
        ("='L'", "\"'L'\" is not admissible"),
        ("=True", "'True' is not admissible"),
        ("=2j", "'2j' is not admissible"),
        ("=1e999", "'1e999' is not admissible"),
        ("=" + "9" * 400, "is not admissible"),
        ("=1if 2else 3", "is no expression"),
        ("=L := 2", "is no expression"),
        ("=L\n+1", "it may hold numbers, parameters"),
        ("=τ", "it may hold numbers, parameters"),
        ("=" + "(" * 150 + "L" + ")" * 150, None),
        ("=" + "-" * 70 + "L", "is nested too deeply"),
        ("=" + "(" * 240 + "L" + ")" * 240, "is no expression"),
        ("=" + "+".join(["L"] * 300), "has at most 500 characters"),
    ],
)
def test_what_is_no_expression_is_refused_in_words(text, reason):
    if reason is None:
        assert names_of(parse_expression(text)) == ("L",)
        return
    with pytest.raises(ValueError) as error:  # noqa: PT011  (its text is compared)
        parse_expression(text)
    assert reason in str(error.value)
    assert "\n" not in str(error.value)


def support(text: str, **laws: list[float]) -> tuple[float, float]:
    """The ends of an expression of uniform numbers."""
    return ParameterTable.from_toml({name: {"uniform": ends} for name, ends in laws.items()}).expression(text).support


def test_the_support_of_products_and_quotients_is_exact():
    assert support("=1/(L*C)", L=[8e-6, 12e-6], C=[8e-5, 12e-5]) == (1 / (12e-6 * 12e-5), 1 / (8e-6 * 8e-5))
    assert support("=2*x", x=[0.0, 0.5]) == (0.0, 1.0)
    assert support("=cos(x)", x=[-0.5, 3.0]) == (math.cos(3.0), 1.0)
    assert support("=(-x)**2", x=[-1.0, 3.0]) == (0.0, 9.0)


@pytest.mark.parametrize(
    ("text", "low", "high", "near"),
    [
        ("=x - x", 0.0, 0.0, 2e-3),
        ("=x/(1 + x)", 0.5, 0.75, 1e-3),
        ("=x*exp(-x)", 3.0 * math.exp(-3.0), math.exp(-1.0), 1e-3),
        ("=(x - y)/(x + y)", -1 / 3, 0.5, 1e-3),
        ("=sin(x)**2 + cos(x)**2", 1.0, 1.0, 2e-3),
        ("=x**2 - 2*x*y + y**2", 0.0, 4.0, 0.2),  # least along a whole line, which takes many boxes
    ],
)
def test_the_support_is_near_the_true_range_where_a_number_occurs_twice(text, low, high, near):
    found = support(text, x=[1.0, 3.0], y=[1.0, 2.0])
    assert found[0] <= low + 1e-12
    assert found[1] >= high - 1e-12
    assert found == pytest.approx((low, high), abs=near)


@pytest.mark.parametrize(
    ("text", "low", "high"),
    [
        ("=x", -math.inf, math.inf),
        ("=x/2 + 1", -math.inf, math.inf),
        ("=x - x/2", -math.inf, math.inf),
        ("=1 - x**2", -math.inf, 1.0),
        ("=exp(-x)", math.ulp(0.0), math.inf),
        ("=log(1 + x**2)", 0.0, math.inf),
        ("=max(x, 0.5)", 0.5, math.inf),
        ("=max(x, 0.5)**0.1", 0.5**0.1, math.inf),
        ("=max(-2, min(x, 3))", -2.0, 3.0),
        ("=3*cos(x)", -3.0, 3.0),
        ("=y*x", -math.inf, math.inf),
        ("=y", 1.0, 2.0),
    ],
)
def test_the_support_is_infinite_where_that_of_a_law_is(text, low, high):
    laws = {"x": {"normal": [1.0, 0.1]}, "y": {"uniform": [1.0, 2.0]}}
    assert ParameterTable.from_toml(laws).expression(text).support == pytest.approx((low, high), abs=1e-3)


def test_no_value_of_a_random_expression_leaves_its_support():
    rng = np.random.default_rng(1)
    ends = {"a": [0.5, 2.0], "b2": [0.1, 0.6], "R_load": [9.0, 14.0], "w0": [1.0, 3.0]}
    columns = {name: rng.uniform(*pair, 4000) for name, pair in ends.items()}
    tried = 0
    for text in programs():
        try:
            low, high = support(f"={text}", **ends)
        except ValueError:
            continue
        tried += 1
        values = np.broadcast_to(evaluate_numbers(parse_expression(f"={text}"), columns.__getitem__), 4000)
        slack = 1e-12 * max(abs(low), abs(high))
        assert low - slack <= values.min() <= values.max() <= high + slack, text
    assert tried > 0.5 * PROGRAMS
