"""C's text of a program: the bits of strict machine code, for every operation and both precisions."""

import ctypes
import subprocess

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dssc_jax.core.numerics import arithmetic
from dssc_jax.lanes.c.operations import c_type
from dssc_jax.lanes.c.text import CText
from dssc_jax.lanes.lanes import CompiledLanes
from dssc_jax.lanes.tracing.origins import translate_with_origins
from dssc_jax.lanes.unsupported import Unsupported
from tests.flight_code.compiling import FLAGS, require

TABLE = np.linspace(-1.0, 2.0, 7) ** 3


def rounding(x, y):
    return jnp.floor(x) + 10.0 * jnp.ceil(y) + 100.0 * jnp.round(x) + 1000.0 * jnp.trunc(x * y)


def signs_of_zero(x, y):
    zeros = jnp.floor(x * 1e-9), jnp.ceil(-jnp.abs(x) * 1e-9), jnp.round(x * 1e-3), jnp.trunc(y * 1e-3)
    return sum(2.0**i * jnp.clip(1.0 / zero, -1.0, 1.0) for i, zero in enumerate(zeros))


def elementary(x, y):
    return jnp.exp(x) + jnp.log(jnp.abs(y)) * jnp.sin(x) + jnp.tanh(y) + jnp.log1p(jnp.abs(x)) * jnp.expm1(y)


def angles(x, y):
    """Also of numbers with many turns."""
    return jnp.sin(x * 1e7) + jnp.cos(y) * jnp.tan(x) + jnp.arctan2(x, y)


def powers(x, y):
    return jnp.power(jnp.abs(x), y) + jnp.exp2(x) - jnp.sinh(y)


def zeros(x, y):
    """The signs of the larger and the smaller of two zeros."""
    a, b = jnp.where(x < 0.0, -0.0, 0.0), jnp.where(y < 0.0, -0.0, 0.0)
    extremes = jnp.maximum(a, b), jnp.minimum(a, b), jnp.maximum(a, 0.0), jnp.minimum(b, -0.0)
    return sum(2.0**i * jnp.clip(1.0 / zero, -1.0, 1.0) for i, zero in enumerate(extremes))


def words(x, y):
    """Conversions, quotients and shifts, where C leaves much to the compiler."""
    n, m = x.astype(jnp.int32), y.astype(jnp.int32)
    wide = jax.lax.bitcast_convert_type(n, jnp.uint32)
    quotients = jax.lax.div(n, m) + jax.lax.rem(n, m) * 3 + jax.lax.div(jnp.int32(-(2**31)), m)
    shifts = jax.lax.shift_left(n, m) ^ jax.lax.shift_right_arithmetic(n, m) ^ jax.lax.shift_right_logical(n, m)
    return (quotients ^ shifts).astype(x.dtype) + (wide >> 3).astype(jnp.int32).astype(x.dtype)


def associated(x, y):
    return x - (y - (x - y)) * (x / (y / x)) + (x + (y + 1.5)) - -x * -(y - x)


def extremes(x, y):
    return jnp.maximum(x, y) - jnp.minimum(2.0, jnp.maximum(y, -0.5)) + jnp.clip(x, -1.0, 1.0) * jnp.sign(y)


def logic(x, y):
    inside = (jnp.abs(x) < 1.0) & ~(y > 2.0) | (x == y) ^ (y != 0.0)
    return jnp.where(inside, x * y, jnp.where(jnp.isfinite(x), y, 3.0))


def integers(x, y):
    n = jnp.int32(100.0 * x)
    m = (n << 3) - (n >> 2) * 7 + (n ^ 12345) - 2147483647
    return m.astype(x.dtype) + y


def table(x, y):
    return jnp.asarray(TABLE, x.dtype)[jnp.int32(jnp.abs(x)) % 7] * y


def newton(x, y):
    """A loop of a lane's own length."""
    a = jnp.abs(x) + 1.0

    def improved(at):
        root, _ = at
        after = 0.5 * (root + a / root)
        return after, jnp.abs(after - root)

    return jax.lax.while_loop(lambda at: at[1] > 1e-6 * a, improved, (a, a))[0] * y


def sided(x, y):
    return jax.lax.cond(x > y, lambda: x * jnp.sqrt(jnp.abs(y)), lambda: x + 2.0 * y)


def swapped(x, y):
    """A state of the loop becomes another."""
    return jax.lax.fori_loop(0, 5, lambda i, at: (at[1], at[0] + 0.25 * at[1]), (x, y))[0]


FUNCTIONS = [
    rounding, signs_of_zero, elementary, angles, powers, zeros, words, associated, extremes, logic, integers, table,
    newton, sided, swapped,
]  # fmt: skip


def numbers(real, function):
    """Ordinary numbers; and special ones for functions whose loops end with them."""
    random = np.random.default_rng(5)
    some = random.normal(0.0, 2.0, (2, 3000)) * 10.0 ** random.integers(-3, 2, (2, 3000))
    special = [0.0, -0.0, 0.5, -0.5, 1.5, 2.5, 1e300, -1e300, np.inf, -np.inf, np.nan, 5e-324, 1e10, -1e10, 1e-320]
    with np.errstate(over="ignore"):
        if function in (newton,):
            return some.astype(real)
        grid = np.array([(x, y) for x in special for y in special]).T
        return np.concatenate([some, grid], axis=1).astype(real)


def compiled_in_c(function, real, folder):
    """The function in C, for columns of numbers."""
    number = jax.ShapeDtypeStruct((), real)
    program, _, origins = translate_with_origins(function, number, number)
    text = CText(program, origins, ["x", "y"], real)
    text.compute(program.outputs)
    kind = c_type(real)
    body = "\n".join([*text.lines, f"    return {text.read(program.outputs[0])};"])
    source = "\n".join(
        [
            "#include <math.h>", "#include <stdbool.h>", "#include <stdint.h>", *text.tables, *text.notation.helpers(),
            *text.functions.values(),
            f"static {kind} one({kind} x, {kind} y)", "{", "    (void)x;", "    (void)y;", body, "}",
            f"void all(const {kind} *x, const {kind} *y, {kind} *z, int count);",
            f"void all(const {kind} *x, const {kind} *y, {kind} *z, int count)", "{",
            "    for (int i = 0; i < count; i++) {", "        z[i] = one(x[i], y[i]);", "    }", "}", "",
        ]
    )  # fmt: skip
    (folder / "one.c").write_text(source)
    command = ["cc", *FLAGS, "-shared", "-fPIC", "one.c", "-o", "one.so", "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr + source
    library = ctypes.CDLL(str(folder / "one.so"))

    def run(x, y):
        z = np.empty_like(x)
        library.all(*(column.ctypes.data_as(ctypes.c_void_p) for column in (x, y, z)), len(x))
        return z

    return run, source


@pytest.mark.parametrize("bits", [64, 32])
@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f.__name__)
def test_same_bits_as_strict_machine_code(function, bits, tmp_path):
    require("cc")
    real = np.dtype(f"float{bits}")
    with arithmetic(bits):
        x, y = (np.ascontiguousarray(column) for column in numbers(real, function))
        number = jax.ShapeDtypeStruct((), real)
        strict = CompiledLanes(function, number, number, strict=True).start((x, y), len(x), 1)()
        run, source = compiled_in_c(function, real, tmp_path)
    ours = run(x, y)
    integer = np.dtype(f"i{bits // 8}")
    same = (ours.view(integer) == strict.view(integer)) | (np.isnan(ours) & np.isnan(strict))
    assert same.all(), (source, x[~same][:3], y[~same][:3], ours[~same][:3], strict[~same][:3])
    assert np.isfinite(strict).mean() > 0.5


def test_names_are_those_of_the_model():
    def slope(rise, run):
        """Rise over run."""
        ratio = rise / run
        return ratio * ratio + 1.0

    def lane(x, y):
        steepness = slope(x + y, x - y)
        halved, doubled = 0.5 * steepness, 2.0 * steepness
        return halved - doubled

    number = jax.ShapeDtypeStruct((), np.float32)
    program, _, origins = translate_with_origins(lane, number, number)
    text = CText(program, origins, ["x", "y"], np.dtype(np.float32), reserved_names=["doubled"])
    text.compute(program.outputs)
    assert [line.strip() for line in text.lines if line] == [
        "/* slope: Rise over run. */",
        "const float ratio = (x + y) / (x - y);",
        "const float steepness = ratio * ratio + 1.0f;",
        "/* lane */",
        "const float halved = 0.5f * steepness;",
        "const float doubled_1 = 2.0f * steepness;",
    ]
    assert text.read(program.outputs[0]) == "halved - doubled_1"


def test_what_c_cannot_say_is_refused():
    def lane(x):
        return x.astype(jnp.uint32).astype(x.dtype)

    program, _, origins = translate_with_origins(lane, jax.ShapeDtypeStruct((), np.float32))
    with pytest.raises(Unsupported, match="conversion of float32 to uint32"):
        CText(program, origins, ["x"], np.dtype(np.float32)).compute(program.outputs)
