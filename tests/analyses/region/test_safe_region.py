"""The boundary of a region of two numbers: against the full lattice, and its simultaneous statement."""

import numpy as np
import pytest
from scipy import stats

import dssc_jax as dj
from dssc_jax.analyses.region.lattice import Thresholds, thresholds
from dssc_jax.analyses.region.safe_region import COARSE, Lattice, PairVerdict, meeting_ends
from dssc_jax.plotting.regions import COLOURS_OF_VERDICTS, enclosed_cells
from tests.loops import LAGGED

TABLE = LAGGED | {
    "name": "region",
    "seed": 2,
    "draws": 300,
    "loop": {"duration": 1.0, "sample_time": 0.05},
    "requirement": [{"metric": "error_max", "after": 0.8, "max": 0.28}],
}
OVER = (dj.RegionAxis("controller.l0", 0.3, 3.0, True), dj.RegionAxis("unmodelled.mu", 0.02, 0.6, True))


@pytest.fixture(scope="module")
def study():
    return dj.Study.from_table(TABLE)


class Disc(Lattice):
    """Failures known in closed form: none in a disc and in a far corner, all elsewhere, some between."""

    def __init__(self, count):
        self.failures = np.full((count, count), -1)
        self.thresholds = Thresholds(most_failures_to_meet=3, least_failures_to_refute=12)
        self.count = count

    def simulate(self, points):
        for i, j in points:
            radius = np.hypot(i / (self.count - 1) - 0.4, j / (self.count - 1) - 0.55)
            self.failures[i, j] = int(np.clip(300.0 * (radius - 0.28), 0.0, 50.0))


@pytest.mark.parametrize("halvings", [0, 2, 4])
def test_the_boundary_followed_is_that_of_the_full_lattice(halvings):
    count = COARSE * 2**halvings + 1
    followed, full = Disc(count), Disc(count)
    followed.follow_boundary(2**halvings)
    full.simulate(np.ndindex(count, count))
    own, every = followed.verdicts(), full.verdicts()
    simulated = own != PairVerdict.NOT_SIMULATED
    assert np.array_equal(own[simulated], every[simulated])
    sides = np.zeros_like(simulated)
    for axis in (0, 1):
        differs = np.diff(every, axis=axis) != 0
        for part in (np.s_[:-1], np.s_[1:]):
            sides[(part, slice(None)) if axis == 0 else (slice(None), part)] |= differs
    assert simulated[sides].all()
    meets = every == PairVerdict.MEETS
    corners = meets[:-1, :-1] & meets[1:, :-1] & meets[:-1, 1:] & meets[1:, 1:]
    np.testing.assert_array_equal(enclosed_cells(every), corners)
    assert not (enclosed_cells(own) & ~corners).any()
    assert enclosed_cells(own).sum() >= 0.9 * corners.sum()
    for sparse, line in zip(own, every, strict=True):
        assert meeting_ends(sparse) in ([], meeting_ends(line))
    if halvings == 4:
        assert simulated.sum() < 0.35 * count**2


def test_thresholds_are_binomial():
    meets, fails = thresholds(1000, 81)
    error = 0.025 / 81
    assert stats.binom.cdf(meets, 1000, 0.05) <= error < stats.binom.cdf(meets + 1, 1000, 0.05)
    assert stats.binom.sf(fails - 1, 1000, 0.05) <= error < stats.binom.sf(fails - 2, 1000, 0.05)
    assert thresholds(50, 81)[0] == -1


def test_failures_are_those_of_a_sweep(study):
    found = dj.region(study, over=OVER, halvings=0)
    axes = {axis.name: found.dataset[name].values.tolist() for axis, name in zip(OVER, found.table, strict=True)}
    swept = dj.run(study.override({"sweep": {name: values[::4] for name, values in axes.items()}}))
    failures = swept.failed.sum("draw").transpose(*axes).values
    np.testing.assert_array_equal(found.dataset["failures"].values[::4, ::4], failures)
    assert np.ptp(failures) > 0


def test_the_ranges_are_those_of_the_pairs_that_meet():
    assert meeting_ends(np.array([0, -1, 0, 1, 2, 0])) == [(0, 2), (5, 5)]
    assert meeting_ends(np.array([-1, 0, 0, 1, 2])) == []
    assert meeting_ends(np.array([2, 1, 1])) == []


def test_the_figure_shows_the_inside_with_plain_numbers(study):
    """A long title is wrapped, verdicts have distinct colours, and logarithmic axes have plain numbers."""
    known = dj.region(study.override({"description": "a long description " * 6}), over=OVER, halvings=1)
    figure = known.figure()
    figure.canvas.draw()
    assert max(map(len, figure.get_suptitle().splitlines())) <= 8 * figure.get_figwidth()
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "enclosed by pairs that pass, no claim" in labels
    assert len({colour for _, colour in COLOURS_OF_VERDICTS.values()}) == 3
    (ax,) = figure.axes
    for axis in (ax.xaxis, ax.yaxis):
        ticks = [tick.get_text() for tick in axis.get_ticklabels()]
        assert ticks == [f"{float(text):g}" for text in ticks]
    rows = known.summary()["safe_ranges"]
    assert rows
    assert all(low <= high for row in rows for low, high in row["second"])


def test_what_cannot_be_decided_or_is_malformed(study):
    with pytest.raises(dj.ConfigError, match="must be at least"):
        dj.region(study.override({"draws": 40}), over=OVER)
    with pytest.raises(dj.ConfigError, match="needs finite LO < HI"):
        dj.region(study, over=(OVER[0], dj.RegionAxis("unmodelled.mu", 0.0, 1.0, True)))
    with pytest.raises(dj.ConfigError, match="two different numbers"):
        dj.region(study, over=(OVER[0], OVER[0]))
