"""Margins by simulation: draw by draw against runs at the values around the critical one."""

import json
import shutil

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.analyses.margins import Margins
from dssc_jax.analyses.margins.search import Censoring, CriticalDraws, CriticalValues, Walk
from dssc_jax.engine import kernels
from dssc_jax.models.actuators import UNMODELLED
from dssc_jax.results import result as results
from dssc_jax.results.manifest import write_json, write_sealed
from dssc_jax.statistics import clopper_pearson
from dssc_jax.study.laws import parse_law
from tests.loops import LAGGED

LOOP = LAGGED | {
    "name": "margins",
    "seed": 4,
    "draws": 40,
    "unmodelled": {"kind": "lag", "order": 2, "mu": {"uniform": [0.01, 0.02]}},
    "requirement": [{"metric": "error_max", "after": 2.0, "max": 0.2}],
}


@pytest.fixture(scope="module")
def study():
    return dj.Study.from_table(LOOP)


@pytest.fixture(scope="module")
def over_mu(study):
    return dj.margin(study, over="unmodelled.mu", bounds=(0.02, 1.5), log=True, points=7, bisections=10)


def passes(study, name, values):
    """Whether each draw passes at each value, by a sweep: shape (values, draws)."""
    return dj.run(study.override({"sweep": {name: list(values)}})).dataset["outcome"].values == 0


def test_the_draw_passes_at_its_critical_value_and_fails_just_beyond(study, over_mu):
    critical = over_mu.dataset["critical"].values
    assert over_mu.summary()["censored"] == 0.0
    assert np.ptp(critical) > 0.005
    step = np.exp(np.log(75.0) / 6 / 2**10) * (1 + 1e-9)
    draws = [0, 17, 39]
    assert passes(study, "unmodelled.mu", critical[draws])[range(3), draws].all()
    assert not passes(study, "unmodelled.mu", critical[draws] * step)[range(3), draws].any()


def test_one_compile(study, monkeypatch):
    compiled = []
    original = kernels.compile_batches
    monkeypatch.setattr(kernels, "compile_batches", lambda *a: compiled.append(1) or original(*a))
    dj.margin(study, over="plant.k_p", bounds=(1.0, 0.01), points=5, bisections=6)
    assert len(compiled) == 1


def test_draws_do_not_depend_on_their_number(study, over_mu):
    few = dj.margin(
        study.override({"draws": 7}), over="unmodelled.mu", bounds=(0.02, 1.5), log=True, points=7, bisections=10
    )
    assert np.array_equal(few.dataset["critical"].values, over_mu.dataset["critical"].values[:7])
    assert np.array_equal(few.dataset["plant.k_p"].values, over_mu.dataset["plant.k_p"].values[:7])


def test_degradation_is_the_run_at_each_value(study, over_mu):
    curve = over_mu.degradation()
    swept = dj.run(study.override({"sweep": {"unmodelled.mu": curve["value"].values.tolist()}}))
    failures = swept.failed.sum("draw").values
    assert np.array_equal(curve["probability"].values, failures / 40)
    assert 0 < failures.max() <= 40
    wide = clopper_pearson(failures, 40, 1.0 - 0.05 / 7)
    assert np.array_equal(np.stack([curve["lower"].values, curve["upper"].values], -1), wide)


@pytest.mark.parametrize(
    ("name", "bounds"), [("disturbance.value", (0.3, 6.0)), ("plant.k_p", (1.3, 0.02)), ("controller.rho", (6.0, 0.1))]
)
def test_every_kind_of_number(study, name, bounds):
    found = dj.margin(study.override({"draws": 16}), over=name, bounds=bounds, points=6, bisections=8)
    assert found.summary()["censored"] < 0.5
    inside = found.dataset["critical"].dropna("draw").values
    assert np.all((inside >= min(bounds)) & (inside <= max(bounds)))


SECOND_ORDER = {"numerator": [1, -0.2], "denominator": [1, 1, 1]}
FORMS = {
    "lag": ({"order": 2, "mu": 0.02}, "mu", (0.02, 1.5)),
    "transfer_function": ({"mu": 0.02, **SECOND_ORDER}, "mu", (0.02, 1.5)),
    "delay": ({"samples": 0.0, "memory": 60}, "samples", (1.0, 60.0)),
    "rate_limit": ({"rate": 50.0}, "rate", (50.0, 0.05)),
    "saturation": ({"limit": 5.0}, "limit", (5.0, 0.02)),
    "quantisation": ({"resolution": 0.001}, "resolution", (0.001, 20.0)),
    "dead_zone": ({"half_width": 0.001}, "half_width", (0.001, 20.0)),
    "backlash": ({"half_width": 0.001}, "half_width", (0.001, 20.0)),
    "lost_command": ({"probability": 0.01}, "probability", (0.01, 0.999)),
    "rational": ({"numerator": [1.0], "denominator": [0.02, 1.0]}, "denominator.0", (0.02, 1.5)),
}


@pytest.mark.parametrize("kind", sorted(UNMODELLED.keys() - {"none"}))
def test_every_form_of_unmodelled_dynamics_has_a_margin(study, kind):
    """From its harmless end: a draw passes at its critical value and fails just beyond. Theorem 1 speaks of none."""
    table, number, bounds = FORMS[kind]
    name = f"unmodelled.{number}"
    formed = study.override({"unmodelled": {"kind": kind, **table}, "draws": 12})
    found = dj.margin(formed, over=name, bounds=bounds, log=True, points=7, bisections=10)
    assert found.summary()["censored"] == 0.0
    critical = found.dataset["critical"].values
    assert np.ptp(critical) > 1e-4
    step = (bounds[1] / bounds[0]) ** (1.0 / 6 / 2**10)
    assert passes(formed, name, critical[[3]])[0, 3]
    assert not passes(formed, name, critical[[3]] * step)[0, 3]
    assert found.certificate.value is None


def test_the_lag_of_a_sensor_has_a_margin(study):
    lagged = study.override({"unmodelled": {"kind": "none"}, "sensor": {"kind": "lag", "mu": 0.02}, "draws": 12})
    found = dj.margin(lagged, over="sensor.mu", bounds=(0.02, 1.5), log=True, points=7, bisections=6)
    assert found.summary()["censored"] == 0.0
    assert "does not cover sensor.mu" in found.certificate.text


def test_sample_time(study):
    few = study.override({"draws": 8, "requirement": [{"metric": "command_tv", "after": 2.0, "max": 2.0}]})
    found = dj.margin(few, over="loop.sample_time", bounds=(0.02, 0.65), log=True, points=3)
    grid = found.dataset["value"].values
    verdicts = [dj.run(few.override({"loop.sample_time": float(t)})).dataset["outcome"].values == 0 for t in grid]
    assert np.array_equal(verdicts, found.dataset["slack"].values >= 0)
    assert 0 < np.sum(verdicts) < np.size(verdicts)
    assert set(found.dataset["critical"].dropna("draw").values) <= set(grid)
    assert found.summary()["bounds"] == [0.02, 0.6] == [grid[0], grid[-1]]  # 6 s are no whole multiple of 0.65 s


def test_spread_is_a_run_under_wider_laws(study):
    """Uniform laws, so many times as wide about the same middle: nested sets with the same draws."""
    few = study.override({"draws": 30, "disturbance.value": {"uniform": [0.1, 0.5]}})
    found = dj.margin(few, over="spread", bounds=(0.5, 2.9), points=6, bisections=6)
    curve = found.degradation()
    assert 0.0 < curve["probability"].values[-1] < 1.0
    for index in (1, 5):
        share = float(curve["value"][index])
        half = {"plant.k_p": (1.0, 0.3), "unmodelled.mu": (0.015, 0.005), "disturbance.value": (0.3, 0.2)}
        wider = {name: {"uniform": [at - share * by, at + share * by]} for name, (at, by) in half.items()}
        failed = dj.run(few.override(wider)).failed.values
        assert np.array_equal(failed, found.dataset["slack"].values[index] < 0.0), share
    assert found.dataset["critical"].attrs["units"] == "1"


def test_spread_is_of_the_logarithm_where_the_law_is():
    law = parse_law({"loguniform": [0.01, 1.0]})
    assert law.spread(np.array([0.01, 0.1, 1.0]), 0.5) == pytest.approx([10**-1.5, 0.1, 10**-0.5])
    assert parse_law({"choice": [1.0, 5.0]}).spread(np.array([1.0, 5.0]), 3.0).tolist() == [1.0, 5.0]
    assert parse_law({"normal": [2.0, 1.0]}).spread(np.array([1.0, 4.0]), 2.0).tolist() == [0.0, 6.0]


@pytest.mark.parametrize(
    ("changes", "bounds", "rule"),
    [
        ({}, (1.0, 4.0), r"plant.k_p must be > 0, got \[-.* at spread = 4; all stay in .* up to spread = 3\.078"),
        ({"plant.k_p": 1.0, "unmodelled.mu": 0.01}, (0.0, 1.0), "nothing is uncertain"),
        ({"plant.k_p": {"choice": [0.9, 1.1]}, "unmodelled.mu": 0.01}, (0.0, 1.0), "nothing is uncertain"),
        ({}, (-1.0, 1.0), "must be >= 0"),
    ],
)
def test_bad_spread(study, changes, bounds, rule):
    with pytest.raises(dj.ConfigError, match=rule):
        dj.margin(study.override(changes), over="spread", bounds=bounds)


def test_what_is_violated_first(study):
    """Beside a requirement that every draw violates at the start, and one that none violates."""
    own = {"metric": "error_max", "after": 2.0, "max": 1.6}
    for bound, first in ((1e-9, "error_rms <= 1e-09 m"), (1e9, None)):
        required = {"requirement": [own, {"metric": "error_rms", "max": bound}], "draws": 12}
        margins = dj.margin(study.override(required), over="unmodelled.mu", bounds=(0.01, 2.0), log=True, points=5)
        failing = int((margins.dataset["censoring"] != 1).sum())
        counts = margins.summary()["first_violated"]
        assert sum(counts.values()) == failing
        assert first is None or counts == {first: 12}
        assert first is not None or "error_rms <= 1e+09 m" not in counts


def test_no_requirement_means_staying_finite(study):
    free = study.override({"requirement": [], "draws": 8})
    found = dj.margin(free, over="plant.a_p", bounds=(1.0, -300.0), points=4, bisections=4)
    assert np.isposinf(found.dataset["slack"].values[0]).all()
    assert np.isneginf(found.dataset["slack"].values[-1]).all()
    assert found.summary()["criterion"] == ["the draw stays finite"]


def margins_of(study, censoring, value, walk):
    """Margins with the given critical values."""
    draws = len(value)
    critical = CriticalValues(
        np.asarray(value), np.asarray(censoring), np.zeros(draws, bool), np.zeros((walk.points, draws))
    )
    critical_draws = CriticalDraws(critical, {})
    return Margins.of(study.override({"draws": draws}), "unmodelled.mu", walk, critical_draws, (), seconds=0.0)


def test_wilks_counts_censored_draws(study):
    """59 draws: the smallest bounds the 5 % quantile; 93: the second smallest. Censored ones keep their places."""
    value, code = np.linspace(1.0, 2.0, 59), np.zeros(59, int)
    walk = Walk(0.5, 2.5)
    assert margins_of(study, code, value, walk).lower_tolerance() == 1.0
    assert margins_of(study, code[1:], value[1:], walk).lower_tolerance() is None
    code[7], value[7] = Censoring.BEFORE, np.nan
    assert margins_of(study, code, value, walk).lower_tolerance() is None
    value, code = np.linspace(1.0, 2.0, 93), np.zeros(93, int)
    code[50], value[50] = Censoring.BEFORE, np.nan
    assert margins_of(study, code, value, walk).lower_tolerance() == 1.0
    code[1:], value[1:] = Censoring.BEYOND, np.nan
    assert margins_of(study, code, value, walk).lower_tolerance() == 2.5


def test_downward_margins_are_ranked_from_the_safe_end(study):
    found = margins_of(study, np.zeros(59, int), np.linspace(-2.0, 1.0, 59), Walk(2.0, -3.0))
    assert found.lower_tolerance() == 1.0
    assert found.summary()["median"] == pytest.approx(-0.5)


@pytest.mark.parametrize(
    ("over", "bounds", "options", "rule"),
    [
        ("unmodelled.mu", (0.1, 0.1), {}, "two different finite numbers"),
        ("unmodelled.mu", (0.1, np.inf), {}, "two different finite numbers"),
        ("unmodelled.mu", (0.0, 1.0), {}, "must be > 0, got 0.0"),
        ("disturbance.value", (0.0, 1.0), {"log": True}, "logarithmic walk needs bounds > 0"),
        ("unmodelled.nu", (0.1, 1.0), {}, "did you mean 'unmodelled.mu'"),
        ("unmodelled.mu", (0.1, 1.0), {"points": 1}, "must be in 2 .."),
        ("unmodelled.mu", (0.1, 1.0), {"bisections": -1}, "must be in 0 .."),
        ("loop.sample_time", (0.0, 1.0), {}, "must be > 0"),
        ("loop.sample_time", (1.0, 6.0), {"points": 30}, "fewer numbers of samples"),
        ("loop.duration", (1.0, 6.0), {}, "clock is fixed"),
    ],
)
def test_bad_input(study, over, bounds, options, rule):
    with pytest.raises(dj.ConfigError, match=rule):
        dj.margin(study, over=over, bounds=bounds, **options)


def test_saved_margins_are_the_same_again(over_mu, tmp_path):
    over_mu.save(tmp_path / "m")
    over_mu.save(tmp_path / "m")
    back = dj.load(tmp_path / "m")
    assert isinstance(back, Margins)
    assert back.dataset.identical(over_mu.dataset)
    assert back.summary() == over_mu.summary()
    assert (back.walk, back.criterion, back.study.hash) == (over_mu.walk, over_mu.criterion, over_mu.study.hash)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").touch()
    with pytest.raises(dj.ConfigError, match="something other than a margin analysis"):
        over_mu.save(tmp_path / "other")


def changed(path, change, seal=True):
    """A JSON file after a change of its content, its digest taken anew or not."""
    content = json.loads(path.read_text())
    if seal:
        del content["digest"]
    change(content)
    (write_sealed if seal else write_json)(path, content)


def inner(content):
    """What the description says beside the dataset."""
    return content["settings"]


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        (lambda path: path.write_text(path.read_text()[:200]), "not valid JSON"),
        (lambda path: path.write_text("[]"), "has no schema version"),
        (lambda path: changed(path, lambda all: [all.pop(name) for name in ("study", "hash")]), "has no study, hash"),
        (lambda path: changed(path, lambda all: all["study"].update(seed=5)), "its study does not match its hash"),
        (
            lambda path: changed(path, lambda all: inner(all).pop("walk")),
            "damaged, or of another version: walk: is missing",
        ),
        (
            lambda path: changed(path, lambda all: inner(all)["walk"].update(end="far")),
            "another version: walk: Input should be a valid number",
        ),
        (
            lambda path: changed(path, lambda all: inner(all)["walk"].update(end=2.0), seal=False),
            "content does not match its digest",
        ),
        (
            lambda path: changed(path, lambda all: all.pop("digest"), seal=False),
            "content does not match its digest",
        ),
    ],
)
def test_a_damaged_description_is_told(over_mu, tmp_path, change, rule):
    over_mu.save(tmp_path)
    path = tmp_path / "margin.json"
    change(path)
    with pytest.raises(dj.ConfigError, match=rule):
        dj.load(tmp_path)


def test_a_damaged_dataset_is_told(over_mu, tmp_path):
    """A chunk that is gone would read as NaN: as draws that are censored."""
    over_mu.save(tmp_path)
    chunks = sorted(path for path in (tmp_path / "data.zarr" / "critical").rglob("*") if path.name != "zarr.json")
    next(chunk for chunk in chunks if chunk.is_file()).unlink()
    with pytest.raises(dj.ConfigError, match="does not hold what was written"):
        dj.load(tmp_path)
    shutil.rmtree(tmp_path / "data.zarr")
    with pytest.raises(dj.ConfigError, match="cannot be read"):
        Margins.load(tmp_path)


@pytest.mark.parametrize("place", [("critical", "units"), ("critical", "long_name"), ("", "parameter")])
def test_an_altered_attribute_is_told(over_mu, tmp_path, place):
    """Units and names that are read back and shown."""
    over_mu.save(tmp_path)
    array, name = place
    changed(
        tmp_path / "data.zarr" / array / "zarr.json", lambda all: all["attributes"].update({name: "km"}), seal=False
    )
    with pytest.raises(dj.ConfigError, match="does not hold what was written"):
        dj.load(tmp_path)


def test_what_is_no_analysis_is_told(over_mu, tmp_path):
    with pytest.raises(dj.ConfigError, match="is no folder"):
        dj.load(tmp_path / "nowhere")
    with pytest.raises(dj.ConfigError, match=r"no manifest.json or margin.json or .*compare.json"):
        dj.load(tmp_path)
    (tmp_path / "answer.json").write_text("{}")
    with pytest.raises(dj.ConfigError, match=r"plain JSON: answer.json"):
        dj.load(tmp_path)
    (tmp_path / "rare.json").write_text("{}")  # as earlier versions wrote it
    with pytest.raises(dj.ConfigError, match="damaged, or of another version"):
        dj.load(tmp_path)
    over_mu.save(tmp_path / "m")
    with pytest.raises(dj.ConfigError, match="it holds what `margin` wrote"):
        results.load_result(tmp_path / "m")
    with pytest.raises(dj.ConfigError, match="holds no compare analysis"):
        dj.Comparison.load(tmp_path / "m")
