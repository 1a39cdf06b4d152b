"""Proofs of the conservative form: its law, distances and starts against closed forms in NumPy, and worst flights."""

import copy
import json

import numpy as np
import pytest
from scipy.linalg import expm

import dssc_jax as dj
from dssc_jax.proofs.coverage import problem_of
from dssc_jax.proofs.prove import check_certificate, prove
from dssc_jax.proofs.search.law_spread import StageRegion, law_spreads, middle_gains
from dssc_jax.proofs.verifier.function_distances import StraightLines, function_distances, increment_error
from dssc_jax.proofs.verifier.gain_enclosures import enclosed_gains, enclosed_start_ratio
from dssc_jax.proofs.verifier.small_gain import MIDDLE_GAINS
from dssc_jax.proofs.verifier.verdict import arb, ball_precision, verify_certificate
from tests.proofs.cases import LOOP

DEFAULT = {"controller.discretisation": "conservative", "controller.predictor_start": "midpoint"}
TABLE_1 = {
    "kind": "vgsta",
    "k_o": 1.0,
    "phi_a": 0.3,
    "phi_b": 4.0,
    "kappa_a": 0.8,
    "kappa_b": 0.5,
    "kappa_c": 2.5,
    "kappa_d": 0.5,
    "epsilon": 0.3,
    "gamma": 3.5,
    "delta": 0.5,
}
ROWS = {
    "vgsta": TABLE_1,
    "square_root": {
        "kind": "square_root",
        "kappa_o": 20.0,
        "kappa_m": 1.0,
        "delta_o": 1.0,
        "delta_m": 0.7,
        "tau_av": 0.02,
    },
    "approx_sta_1": {"kind": "approx_sta_1", "kappa1": 4.0, "kappa2": 4.0, "delta": 0.5, "k_o": 20.0},
    "approx_sta_2": {"kind": "approx_sta_2", "kappa1": 4.0, "kappa2": 4.0, "delta": 0.5, "tau_av": 0.02},
    "field": {"kind": "field", "k_o": 20.0, "kappa1": 4.0, "kappa2": 4.0, "delta": 0.02},
    "constant": {"kind": "constant", "k_o": 5.0, "tau_av": 0.05, "tau_m": 0.5},
}
"""Every row of functions with a finite slope."""
STUDY = LOOP.override(
    {
        **DEFAULT,
        "controller.functions": TABLE_1,
        "loop.sample_time": 0.004,
        "plant.k_p": {"uniform": [0.95, 1.05]},
        "plant.a_p": {"uniform": [-0.5, 0.5]},
        "unmodelled.mu": 0.005,
        "disturbance.period": 6.0,
        "disturbance.amplitude": 0.1,
    }
)


def law(row, sigma, e):
    """phi_1 and phi_2 of each row, written out from the tables, and k_o tau_av."""
    r = np.sqrt(np.abs(sigma))
    match row["kind"]:
        case "vgsta":
            kappa = row["kappa_a"] * np.abs(sigma) + row["kappa_b"] * np.abs(e) + row["kappa_c"]
            kappa1 = kappa**2 + row["kappa_d"]
            rd = r + row["delta"]
            phi = row["phi_a"] * sigma / rd + row["phi_b"] * sigma
            slope = row["phi_a"] * (r + 2.0 * row["delta"]) / (2.0 * rd**2) + row["phi_b"]
            by_sigma = 2.0 * kappa * row["kappa_a"] * np.sign(sigma)
            kappa2 = 2.0 * row["epsilon"] * kappa1 + row["gamma"]
            return kappa1 * phi, kappa2 * phi * slope, 1.0 / (by_sigma * phi + kappa1 * slope)
        case "constant":
            gain = 1.0 / (row["k_o"] * row["tau_av"])
            return gain * sigma, gain * sigma / row["tau_m"], np.full_like(sigma, 1.0 / gain)
        case "square_root":
            kappa1, delta = 2.0 / (row["kappa_o"] * row["tau_av"]), row["delta_o"]
            tau_m = row["kappa_m"] * (r + row["delta_m"])
        case "field":
            kappa1, delta = row["kappa1"], 0.5 * row["k_o"] * row["kappa1"] * row["delta"]
            tau_m = row["kappa1"] * r / (2.0 * row["kappa2"]) + row["delta"]
        case _:
            kappa1, delta = row["kappa1"], row["delta"]
            tau_m = row["kappa1"] / row["kappa2"] * (r + delta)
    if row["kind"] == "approx_sta_1":
        tau_m = row["kappa1"] / row["kappa2"] * r / (1.0 - delta / r * np.log1p(r / delta))
    product = 2.0 * (r + delta) / kappa1
    return kappa1 * (r - delta * np.log1p(r / delta)) * np.sign(sigma), sigma / (product * tau_m), product


def points(rng, sigma, e, count=20_000):
    """Points of a region, many of them at its ends."""
    s = rng.choice([-1.0, 1.0], count) * sigma * rng.beta(0.3, 0.3, count)
    return np.where(np.abs(s) < 1e-6 * sigma, 1e-6 * sigma, s), e * (2.0 * rng.beta(0.3, 0.3, count) - 1.0)


@pytest.mark.parametrize("kind", ROWS)
def test_changes_of_phi_1_follow_the_gains(kind):
    """phi_1 changes between any two points by gains within the verifier's balls; so do the ratios to sigma."""
    row, rng, region = ROWS[kind], np.random.default_rng(1), (0.4, 0.3)
    content = problem_of(LOOP.override({**DEFAULT, "controller.functions": row})).to_dict()
    (s, e), (moved_sigma, moved) = points(rng, *region), points(rng, *region)
    (first, second, product), (next_phi_1, _, _) = law(row, s, e), law(row, moved_sigma, moved)
    with ball_precision():
        balls = {name: (float(x.lower()), float(x.upper())) for name, x in enclosed_gains(content, *region).items()}
    for name, values in (("mean", first / s), ("k_i", second / s), ("k_p", 1.0 / product)):
        low, high = balls[name]
        assert low * (1.0 - 1e-9) <= values.min()
        assert values.max() <= high * (1.0 + 1e-9)
        assert high - low <= 1.1 * np.ptp(values) + 1e-9 * high
    reach = 1.0 + (row["tau_av"] if "tau_av" in row else product / row["k_o"]) / content["sample_time"]
    by_e = balls["slide_e"][1] / reach.max() if kind == "vgsta" else 0.0
    change, by_error = moved_sigma - s, by_e * np.abs(moved - e) + 1e-9
    ends = np.stack([balls["k_p"][0] * change, balls["k_p"][1] * change])
    assert np.all(next_phi_1 - first <= ends.max(axis=0) + by_error)
    assert np.all(next_phi_1 - first >= ends.min(axis=0) - by_error)
    requested = reach * (next_phi_1 - first)  # what the sliding condition asks for at the later point, besides phi_2
    assert np.abs(requested).max() <= balls["slide_p"][1] * np.abs(change).max() + balls["slide_e"][1] * 2.0 * region[1]


@pytest.mark.parametrize("kind", ROWS)
@pytest.mark.parametrize("region", [(0.4, 0.3), (20.0, 5.0), (1e-7, 1e-7)])
def test_functions_are_as_far_from_their_lines_as_the_verifier_says(kind, region):
    """Against 20,000 points; the bounds are hardly larger, and the search's own a little larger than they."""
    row, rng = ROWS[kind], np.random.default_rng(2)
    nominal = {"controller.nominal": {"a": 0.8, "k": 1.1}}
    problem = problem_of(LOOP.override({**DEFAULT, **nominal, "controller.functions": row}))
    *_, spread = law_spreads(problem, StageRegion(*region, 1e-3))
    slopes = dict(zip(MIDDLE_GAINS["phi_1"], middle_gains(spread), strict=True))
    with ball_precision():
        lines = StraightLines({name: arb(value) for name, value in slopes.items()})
        distances = {
            name: float(x) for name, x in function_distances(problem.to_dict(), region[0], region[1], lines).items()
        }
    s, e = points(rng, *region)
    s = np.concatenate([s, region[0] * np.geomspace(1e-3, 1.0, 2000), region[0] * np.linspace(0.001, 1.0, 2000)])
    e = np.concatenate([e, np.zeros(2000), np.full(2000, region[1])])
    first, second, product = law(row, s, e)
    by_e = 0.0
    if kind == "vgsta":  # what (29) holds of kappa_1's change with e
        kappa = row["kappa_a"] * np.abs(s) + row["kappa_b"] * np.abs(e) + row["kappa_c"]
        ratio = row["phi_a"] / (np.sqrt(np.abs(s)) + row["delta"]) + row["phi_b"]
        by_e = 2.0 * kappa * row["kappa_b"] * np.sign(e) * ratio * (s - problem.l0 * e) * s
    pole = (second + by_e) * product / 1.1  # sigma/(k_n tau_m)
    found = {
        "phi_1": np.abs(first - slopes["mean"] * s).max(),
        "phi_2": np.abs(second - slopes["k_i"] * s).max(),
        "both": np.abs(first + pole - (slopes["mean"] + slopes["k_n"]) * s).max(),
    }
    size = region[0] * max(abs(slopes["mean"]), abs(slopes["k_i"]))
    for name, value in found.items():
        assert value <= distances[name] + 1e-12 * size
        assert distances[name] <= 1.06 * value + 1e-9 * size
    t = problem.sample_time
    searched = {"phi_1": spread.slide.constant, "phi_2": spread.integral.constant / t, "both": spread.command.constant}
    for name, value in searched.items():
        assert distances[name] <= value <= 1.1 * distances[name] + 1e-9 * size


@pytest.mark.parametrize("kind", [kind for kind in ROWS if kind != "vgsta"])
@pytest.mark.parametrize("change", [1e-4, 0.02, 0.5])
def test_the_implicit_increment_is_as_far_from_that_of_phi_1_as_the_verifier_says(kind, change):
    """K_P(sigma) (sigma - s) against phi_1(sigma) - phi_1(s) at random points; sharp at sigma = 0 and next to 0."""
    row, rng = ROWS[kind], np.random.default_rng(3)
    problem = problem_of(LOOP.override({**DEFAULT, "controller.functions": row}))

    def error(sigma, s):
        first, _, product = law(row, np.where(sigma == 0.0, 1e-15, sigma), 0.0)
        before, _, _ = law(row, np.where(s == 0.0, 1e-15, s), 0.0)
        return np.abs((sigma - s) / product - first + before)

    with ball_precision():
        for low in (0.0, 0.5 * change, change, 3.0 * change, 0.7, 20.0):
            size = low + np.concatenate([[0.0], change * rng.random(4000), 10.0 * rng.random(4000)])
            sigma = size * rng.choice([-1.0, 1.0], size.size)
            share = np.where(rng.random(size.size) < 0.5, 1.0, rng.random(size.size))
            s = sigma + change * share * rng.choice([-1.0, 1.0], size.size)
            s[0] = sigma[0] - np.copysign(change, sigma[0])
            bound = float(increment_error(problem.to_dict(), low, change))
            found = error(sigma, s)
            assert found.max() <= bound + 1e-13
            if low == 0.0 or low >= change:
                assert bound <= found[0] * (1.0 + 1e-4) + 1e-13


@pytest.mark.parametrize("form", ["implicit", "conservative"])
@pytest.mark.parametrize("kind", ["vgsta", "square_root"])
@pytest.mark.parametrize("start", ["zero", "matched", "midpoint"])
def test_the_first_command_follows_from_the_start(form, kind, start):
    """v of the proof before the first sample, carried over it, is the simulated u_av; the clip sees no more."""
    changes = {"controller.discretisation": form, "controller.predictor_start": start, "plant.initial": [0.2, 0.1]}
    changes |= {"controller.rho": 1e4}
    study = STUDY.override({**changes, "controller.functions": ROWS[kind], "plant.k_p": 1.0, "plant.a_p": 0.3})
    problem = problem_of(study)
    sigma, e, t = np.array(0.1 + 0.5 * 0.2), np.array(0.2), 0.004
    first, second, product = law(ROWS[kind], sigma, e)
    if form == "implicit":  # linear in the gains of the sample, of (28) and (29)
        row = ROWS["vgsta"]
        kappa = row["kappa_a"] * sigma + row["kappa_b"] * e + row["kappa_c"]
        ratio = row["phi_a"] / (np.sqrt(sigma) + row["delta"]) + row["phi_b"]
        by_e = 2.0 * kappa * row["kappa_b"] * ratio * (sigma - 0.5 * e) * sigma if kind == "vgsta" else 0.0
        first, second = sigma / product, second + by_e
    with ball_precision():
        ratio = enclosed_start_ratio(problem.to_dict(), is_integrated=form == "conservative")
        v_before_start = -float(ratio.mid()) * (0.0 if start == "zero" else sigma)
        radius = float(ratio.rad()) * float(sigma)
    predictor = 0.0 if start == "zero" or form == "conservative" else first
    u_av = v_before_start + first - predictor + t * second
    run = dj.simulate(study.override({"loop.duration": 0.4}))
    assert run["u_av"].values[0] == pytest.approx(float(u_av), abs=radius + 1e-9 * abs(float(first)))
    assert radius < 2e-4 * abs(first)  # the ball holds the gains of both signs of e
    expected = {"zero": first + t * second, "matched": t * second, "midpoint": 0.5 * t * second}[start]
    assert float(u_av) == pytest.approx(float(expected), rel=1e-9, abs=radius)
    tau_av = product if kind == "vgsta" else 0.02  # k_o = 1 in Table 1's row here
    proved = v_before_start + (first if form == "conservative" and start != "zero" else 0.0)
    proved += (1.0 + tau_av / t) * (t * second + (first if start == "zero" else 0.0))
    used = study.template.controller[0].rho.rho - run["sliding_margin"].values[0]
    assert used <= abs(proved) * (1.0 + 1e-9)


class Flights:
    """Many flights of the conservative form, in NumPy, with the exact hold of a plant with a lag of order 2."""

    def __init__(self, problem, rng, count):
        self.problem, self.count, self.t = problem, count, problem.sample_time
        k_p, a_p = (
            np.where(rng.random(count) < 0.7, rng.choice(pair, count), rng.uniform(*pair, count))
            for pair in (problem.k_p, problem.a_p)
        )
        self.held = np.stack([self.plant(*plant) for plant in zip(k_p, a_p, strict=True)])

    def plant(self, k_p, a_p):
        """One sample: rows of e, e', x_1, x_2, columns of these, u, d and d'."""
        f, mu = np.zeros((7, 7)), self.problem.mu[0]
        f[0, 1], f[1, 1], f[1, 3], f[1, 5] = 1.0, -a_p, k_p, k_p
        f[2, 2], f[2, 4], f[3, 2], f[3, 3] = -1.0 / mu, 1.0 / mu, 1.0 / mu, -1.0 / mu
        f[5, 6] = 1.0
        return expm(f * self.t)[:4]

    def fly(self, slopes, first):
        """Largest |e| from the start on and in the last sixth, and the least sliding margin; the clip included."""
        row, rho, level, t = self.problem.functions, self.problem.rho, self.problem.level, self.t
        state = np.zeros((self.count, 4))
        state[:, 0], state[:, 1] = (pair[0] for pair in self.problem.initial[:2])
        d, u_av, w = first.copy(), np.zeros(self.count), None
        largest, settled, room = np.abs(state[:, 0]), np.zeros(self.count), np.full(self.count, np.inf)
        for k, slope in enumerate(slopes):
            e, sigma = state[:, 0], state[:, 1] + self.problem.l0 * state[:, 0]
            phi_1, phi_2, product = law(row, np.where(sigma == 0.0, 1e-12, sigma), e)
            share = t / (product / row["k_o"] + t)
            w = phi_1 + 0.5 * t * phi_2 if w is None else w
            requested = (phi_1 + t * phi_2 - w) / share
            change = np.clip(requested, -rho - u_av, rho - u_av)
            w = (w + share * change) * phi_1 / (phi_1 + t * phi_2)
            room = np.minimum(room, rho - np.abs(u_av + requested))
            u_av = u_av + share * change
            kept = np.clip(slope, (-level - d) / t, (level - d) / t)
            state = np.einsum("nij,nj->ni", self.held, np.column_stack([state, -u_av, d, kept]))
            d = d + t * kept
            largest = np.maximum(largest, np.abs(state[:, 0]))
            if 6 * k > 5 * len(slopes):
                settled = np.maximum(settled, np.abs(state[:, 0]))
        return largest, settled, room

    def worst(self, steps, i):
        """Signs of the linearised loop's impulse response from d to e, turned in time."""
        row, t, l0 = self.problem.functions, self.t, self.problem.l0
        phi_1, phi_2, _ = (float(x) for x in law(row, np.array(1e-9), np.array(0.0)))
        a = np.zeros((6, 6))  # e, e', x_1, x_2, q, d
        sigma = np.array([l0, 1.0, 0.0, 0.0, 0.0, 0.0])
        a[4] = np.eye(6)[4] + t * phi_2 / 1e-9 * sigma
        a[:4, :4], a[:4, 5], a[5, 5] = self.held[i][:, :4], self.held[i][:, 5], 1.0
        a[:4] -= np.outer(self.held[i][:, 4], a[4] + phi_1 / 1e-9 * sigma)
        z, response = np.eye(6)[5], np.empty(steps)
        for k in range(steps):
            response[k] = z[0]
            z = a @ z
        return np.where(response[::-1] < 0.0, -1.0, 1.0)


def test_worst_flights_of_table_1_stay_within_what_is_proved():
    """1,000 flights at the steepest slopes: triangles of any period, and the worst inputs of the linear loop."""
    outcome = prove(STUDY, boxes=1)
    assert outcome.complete, outcome.failures
    problem, rng, steps, count = outcome.problem, np.random.default_rng(3), 6000, 1000
    flights = Flights(problem, rng, count)
    time, period = (
        problem.sample_time * np.arange(steps)[:, None],
        np.exp(rng.uniform(np.log(0.03), np.log(24.0), count)),
    )
    signs = np.where((time / period + rng.random(count)) % 1.0 < 0.5, 1.0, -1.0)
    for i in range(40):
        signs[:, i] = flights.worst(steps, i)
    first = rng.choice([0.0, -1.0, 1.0], count) * (problem.level - problem.sample_time * problem.slope)
    first[:40] = 0.0
    largest, settled, room = flights.fly(problem.slope * signs, first)
    print(
        f"\nproved {outcome.largest_error:.4f}, {outcome.error:.3e} m; flown {largest.max():.4f}, {settled.max():.3e} m"
    )
    assert largest.max() <= outcome.largest_error < 1.5 * largest.max()
    assert settled.max() <= outcome.error < 3.0 * settled.max()
    assert room.min() > 0.0
    run = dj.simulate(STUDY.override({"plant.k_p": 1.0, "plant.a_p": 0.3, "disturbance": {"kind": "none"}}))
    flights.held[:] = flights.plant(1.0, 0.3)
    alone, _, _ = flights.fly(np.zeros((1000, 1)), np.zeros(count))
    assert alone[0] == pytest.approx(np.abs(run["e"].values[:1001]).max(), rel=1e-6)


@pytest.mark.parametrize("kind", [kind for kind in ROWS if kind != "vgsta"])
def test_flights_of_every_other_row_stay_within_what_is_proved(kind):
    """With the start ``midpoint``, by the package's own simulator."""
    study = STUDY.override({"controller.functions": ROWS[kind], "plant.a_p": 0.3, "controller.rho": 6.0})
    outcome = prove(study, boxes=2)
    assert outcome.complete, outcome.failures
    waves = study.override({"draws": 256, "disturbance.phase": {"uniform": [0.0, 6.28]}, "loop.duration": 30.0})
    flown = dj.run(waves.override({"metrics": {"after": 0.0, "names": ["error_max", "outside_sliding"]}})).dataset
    settled = dj.run(waves.override({"metrics": {"after": 25.0, "names": ["error_max"]}})).dataset
    assert float(flown["error_max"].max()) <= outcome.largest_error
    assert float(settled["error_max"].max()) <= outcome.error
    assert np.all(flown["outside_sliding"].values == 0.0)


def test_a_forged_certificate_of_the_conservative_form_is_refused():
    """Of another start, form, law or place, each by the premise that fails; and of bounds that are too small."""
    certificate = json.loads(json.dumps(prove(STUDY, boxes=1).certificate()))
    assert check_certificate(certificate).proved
    first = certificate["proofs"][0]["stages"][0]
    forged = {
        "start": ("zero", ("P3", "P5", "P7")),
        "form": ("implicit", ("P0",)),
        "functions": (TABLE_1 | {"kappa_b": 1.5}, ("P3", "P5", "P6", "P7")),
        "initial": ([[0.25, 0.25], [0.0, 0.0]], ("P3", "P7")),
        "rho": (1.2, ("P5",)),
    }
    for name, (value, premises) in forged.items():
        content = copy.deepcopy(certificate)
        content["problem"][name] = value
        verdict = verify_certificate(content)
        assert not verdict.proved
        assert verdict.reason.startswith(premises), (name, verdict.reason)
    for number, stage in enumerate(certificate["proofs"][0]["stages"]):
        if stage["method"] != "small gain":
            continue
        for place in (1, 2, 3):  # sigma, e and the command
            content = copy.deepcopy(certificate)
            content["proofs"][0]["stages"][number]["bounds"][place] *= 0.8
            assert verify_certificate(content).reason.startswith("P7")
    content = copy.deepcopy(certificate)
    content["proofs"][0]["stages"][0].update(sigma=0.5 * first["sigma"])
    assert verify_certificate(content).reason.startswith("P4")


@pytest.mark.parametrize(
    ("name", "changes", "largest", "error"),
    [
        ("certified_margin", {"unmodelled.mu": 0.01}, 0.2270, 3.27e-4),
        ("channel_x", {}, 1.74, 1.388),
        ("tune_proved", {}, 0.2172, 2.99e-4),
        ("design_map_kappa_d", {}, 0.2147, 2.99e-4),
    ],
)
def test_packaged_studies_close_with_form_and_start(name, changes, largest, error):
    """In one box, with bounds that are no larger than the implicit form's,
    but for 0.1 % of the first."""
    study = dj.Study.load(f"studies/{name}.toml").without_sweep().override({**DEFAULT, **changes})
    outcome = prove(study, boxes=1)
    assert outcome.complete, outcome.failures
    assert outcome.largest_error <= largest
    assert outcome.error <= error
