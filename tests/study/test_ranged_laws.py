"""Laws whose arguments are ranges: what a study file may say, their densities, and who refuses them."""

import copy

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.flight_code.folder import FlightFolder
from dssc_jax.proofs.coverage import problem_of
from dssc_jax.study.laws import LAWS, Law, RangedLaw, parse_law
from tests.analyses.test_one_shape import HOVER, LOG, PAIR, SPENT, TABLE, WALK
from tests.proofs.cases import LOOP
from tests.study.test_laws import ORACLES


def test_every_kind_but_choice_and_point_has_a_density():
    """Without one, the arguments of a law may not be ranges."""
    assert [kind for kind, spec in LAWS.items() if not spec.log_density] == ["choice", "point"]


@pytest.mark.parametrize("case", ORACLES, ids=str)
def test_densities(case):
    """Against SciPy, also outside of the support."""
    kind, arguments = case
    low, high = ORACLES[case].ppf([0.01, 0.99])
    around = np.linspace(2.0 * low - high, 2.0 * high - low, 200)
    values = np.concatenate([around, LAWS[kind].quantile(np.linspace(0.01, 0.99, 50), *arguments)])
    expected = ORACLES[case].logpdf(values)
    np.testing.assert_allclose(LAWS[kind].log_density(values, *arguments), expected, rtol=1e-9, atol=1e-9)


def test_parsing():
    law = parse_law({"normal": [[0.9, 1.1], 0.05]})
    assert law == RangedLaw("normal", (1.0, 0.05), ((0.9, 1.1), (0.05, 0.05)))
    assert law.corners == [Law("normal", (0.9, 0.05)), Law("normal", (1.1, 0.05))]
    assert str(law) == "normal([0.9, 1.1], 0.05)"
    assert parse_law(law.table) == law
    assert parse_law({"uniform": [[0.7, 0.9], [1.1, 1.3]]}).support == (0.7, 1.3)


@pytest.mark.parametrize(
    ("table", "told"),
    [
        ({"normal": [[1.1, 0.9], 0.1]}, "lo below hi"),
        ({"normal": [[1.0, 1.0], 0.1]}, "lo below hi"),
        ({"normal": [1.0, [-0.1, 0.1]]}, "std must be positive"),
        ({"uniform": [[0.0, 1.0], [0.9, 2.0]]}, "lo must be below hi"),
        ({"choice": [[1.0, 2.0], 3.0]}, "the arguments of a choice may not be ranges"),
        ({"normal": [[0.9, 1.0, 1.1], 0.1]}, "finite numbers"),
        ({"normal": [[0.9, "x"], 0.1]}, "finite numbers"),
    ],
)
def test_bad_ranges(table, told):
    with pytest.raises(ValueError, match=told):
        parse_law(table)


@pytest.fixture(scope="module")
def study():
    table = copy.deepcopy(TABLE)
    table["disturbance"]["value"] = {"uniform": [[-0.6, -0.5], 0.6]}
    return dj.Study.from_table(table)


def vehicle():
    table = copy.deepcopy(HOVER)
    table["plant"]["vehicle"]["mass"] = {"uniform": [[10.4, 10.6], 11.5]}
    return dj.Study.from_table(table)


REFUSED = {
    "run": dj.run,
    "run_until": lambda study: dj.run_until(study, dj.UntilWidth(0.1)),
    "simulate": lambda study: dj.simulate(study, 0),
    "lane": dj.lane,
    "stepper": dj.stepper,
    "code": FlightFolder,
    "margin": lambda study: dj.margin(study, **WALK),
    "margins": lambda study: dj.compare_margins(study, ["dssc", "pi"], **WALK),
    "loop": dj.loop_margins,
    "compare": lambda study: dj.compare(study, ["dssc", "pi"], candidates=2, tuning_draws=4),
    "sensitivity": lambda study: dj.sensitivity(study.override({"draws": 256})),
    "laws": dj.laws,
    "region": lambda study: dj.region(study.override({"draws": 200}), over=PAIR, halvings=0),
    "compare_log": lambda study: dj.compare_log(study, LOG),
    "rare": lambda study: dj.rare(study, SPENT),
    "falsify": lambda study: dj.falsify(study, budget=40),
    "tune": dj.tune,
    "worst_wind": lambda _: dj.worst_wind(vehicle(), segments=4, rounds=1),
    "theory": lambda study: dj.theory.assess(study, **WALK),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_needs_single_laws_refuses_ranges(study, name):
    with pytest.raises(dj.ConfigError, match=r"the arguments of uniform\(\[.*\], .*dj\.law_ranges"):
        REFUSED[name](study)


def test_a_swept_number_has_no_law(study):
    assert dj.run(study.override({"sweep": {"disturbance.value": [0.1, 0.2]}}), check=False).failed.size == 32


def test_bounds_are_those_of_all_laws(study):
    with pytest.raises(dj.ConfigError, match="support is"):
        study.override({"plant.k_p": {"uniform": [[-0.1, 0.5], 1.2]}})
    with pytest.raises(dj.ConfigError, match="cannot be correlated"):
        study.override({"correlation": {"plant.k_p, disturbance.value": 0.3}})


def test_a_proof_covers_all_laws():
    """It needs the bounds of the values only, so that its problem is that of the widest law."""
    widest = LOOP.override({"plant.k_p": {"uniform": [0.98, 1.0]}})
    ranged = LOOP.override({"plant.k_p": {"uniform": [[0.98, 0.99], 1.0]}})
    assert problem_of(ranged).to_dict() == problem_of(widest).to_dict()
    assert dj.prove(ranged, boxes=1).statement() == dj.prove(widest, boxes=1).statement()


def test_the_study_in_words(study):
    assert "uniform([-0.6, -0.5], 0.6)" in str(study)
    assert "2 uncertain" in repr(study)
