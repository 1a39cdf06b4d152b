"""Names of computations: another for whatever changes the result, none for what cannot be described completely."""

import functools
import itertools

import jax
import numpy as np
import pytest

import dssc_jax
from dssc_jax.core.integrators import rk4
from dssc_jax.core.numerics import clip
from dssc_jax.core.trace_memory import names as naming
from dssc_jax.core.trace_memory.names import cache_key, sources_digest
from dssc_jax.core.vectors import Vec3
from dssc_jax.engine.batching import lane_of_study
from dssc_jax.engine.evaluation import forward_mode
from dssc_jax.study import Study
from tests.conftest import UNCERTAIN

LONG = np.linspace(0.0, 1.0, 2000)
OTHER = np.where(np.arange(2000) == 1000, 0.25, LONG)  # NumPy prints both as the same text


@pytest.fixture
def known(monkeypatch):
    """As if this file were the package's own."""
    monkeypatch.setattr(naming, "DESCRIBED", (*naming.DESCRIBED, "tests"))
    naming.qualified_name.cache_clear()
    yield
    naming.qualified_name.cache_clear()


def test_things_that_differ_in_anything_have_different_names():
    things = [
        None, True, 1, 1.0, 1 + 0j, "1", b"1", 0.0, -0.0, float("nan"),
        [1], (1,), {1: 1}, {1: (1,)}, {1: 1, 2: 2}, {2: 2, 1: 1},
        ((1,), 2), (1, (2,)), (1, 2), ("ab", "c"), ("a", "bc"), ("abc",),
        LONG, OTHER, LONG.astype(np.float32), LONG[:, None], np.float64(1.0), np.float32(1.0), np.array(1.0),
        Vec3(1.0, 2.0, 3.0), (1.0, 2.0, 3.0), Vec3, rk4, clip, Vec3(0.0, 1.0, 0.0).dot,
        functools.partial(clip, 1.0), functools.partial(clip, 2.0), functools.partial(clip, low=1.0),
        jax.ShapeDtypeStruct((), np.float64), jax.ShapeDtypeStruct((), np.float32),
        jax.ShapeDtypeStruct((1,), np.float64),
    ]  # fmt: skip
    names = [cache_key(thing) for thing in things]
    assert None not in names
    assert len(set(names)) == len(things)
    assert cache_key(*things) == cache_key(*things)
    assert cache_key(1, 2) != cache_key((1, 2))


@pytest.mark.parametrize(
    "change",
    [
        {"seed": 4},
        {"loop.duration": 4.01},
        {"loop.precision": 32},
        {"plant.initial": [1.0, 0.1]},
        {"plant.k_p": 1.0},
        {"controller.functions.kappa1": 1.0 + 2**-52},
        {"controller.discretisation": "explicit"},
        {"disturbance.std": 0.3},
        {"requirement": []},
        {"sweep": {"controller.l0": [0.5, 1.0]}},
    ],
    ids=str,
)
def test_a_lane_has_another_name_if_anything_of_its_study_differs(change):
    study, changed = Study.from_table(UNCERTAIN), Study.from_table(UNCERTAIN).override(change)
    assert cache_key(lane_of_study(study)) == cache_key(lane_of_study(Study.from_table(UNCERTAIN)))
    assert None is not cache_key(lane_of_study(study)) != cache_key(lane_of_study(changed)) is not None


def test_programs_of_one_study_have_different_names():
    study = Study.from_table(UNCERTAIN)
    lanes = (
        lane_of_study(study),
        lane_of_study(study, axis_name=None),
        *(forward_mode(study, [name]) for name in study.axes),
    )
    assert len({None, *map(cache_key, lanes)}) == len(lanes) + 1


def test_the_settings_of_jax_are_part_of_a_name():
    with jax.enable_x64(False):
        single = cache_key(clip)
    with jax.threefry_partitionable(not jax.config.jax_threefry_partitionable):
        assert len({single, cache_key(clip)}) == 2
    assert cache_key(clip) not in (single, None)


def mine(x):
    return x


@functools.wraps(clip)
def disguised(x, low, high):
    return x


class Own(Vec3):
    pass


def closing_over(value):
    return lambda x: x + value


@pytest.mark.parametrize(
    "thing",
    [
        mine,
        disguised,
        Own,
        Own(1.0, 2.0, 3.0),
        (1, [{"a": mine}]),
        {mine: 1},
        functools.partial(clip, mine),
        functools.partial(mine, 1.0),
        jax.jit(mine),
        np.array([None]),
        jax.random.key(0),
        object(),
        {1, 2},
        iter("ab"),
        np.random.default_rng(),
    ],
    ids=lambda thing: type(thing).__name__,
)
def test_what_is_not_described_completely_has_no_name(thing):
    assert cache_key(thing) is None


def test_functions_are_told_apart_by_place_and_by_what_they_close_over(known):
    same_line = [lambda x: x, lambda x: x + 0, lambda x, y=1: x, lambda x, y=2: x, lambda x, *, y=2: x]
    closures = [closing_over(1), closing_over(1.0), closing_over(mine), closing_over(closing_over(1))]
    functions = [mine, jax.jit(mine), disguised, *same_line, *closures]
    names = [cache_key(function) for function in functions]
    assert None not in names
    assert len(set(names)) == len(functions)
    assert cache_key(closing_over(1)) == cache_key(closing_over(1))


def test_a_function_may_close_over_itself(known):
    def endless(x):
        return endless(x)

    def other(x):
        return x and other(x)

    names = {cache_key(endless), cache_key(other)}
    assert len(names) == 2
    assert None not in names


def test_sources_that_may_not_be_what_runs_have_no_name(monkeypatch):
    assert cache_key(1) is not None
    sources_digest.cache_clear()
    newest = max(file.stat().st_ctime for file in naming.package_sources())
    for imported, some in ((newest + 1e-6, True), (newest, False)):
        monkeypatch.setattr(dssc_jax, "IMPORTED", imported)
        assert (cache_key(1) is not None) == some
        sources_digest.cache_clear()
    monkeypatch.undo()
    monkeypatch.setattr(naming, "package_sources", list)  # as from an archive
    assert cache_key(1) is None
    sources_digest.cache_clear()


def test_every_byte_of_every_source_is_part_of_a_name(monkeypatch, tmp_path):
    root = tmp_path / "package"
    names = set()
    for content, file in itertools.product(["a = 1\n", "a = 2\n"], ["one.py", "layer/two.py"]):
        for path in root.rglob("*.py"):
            path.unlink()
        (root / file).parent.mkdir(parents=True, exist_ok=True)
        (root / file).write_text(content)
        monkeypatch.setattr(dssc_jax, "__file__", str(root / "__init__.py"))
        monkeypatch.setattr(dssc_jax, "IMPORTED", float("inf"))
        sources_digest.cache_clear()
        names.add(cache_key(1))
    sources_digest.cache_clear()
    assert len(names) == 4
    assert None not in names
