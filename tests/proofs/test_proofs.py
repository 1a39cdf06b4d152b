"""Proofs of the sampled loop: matrices against the simulated loop, certificates and what is wrong with false ones."""

import copy
import json

import numpy as np
import pytest
from flint import arb

import dssc_jax as dj
from dssc_jax.cli import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.design.certification import NotCovered
from dssc_jax.proofs import small_gain
from dssc_jax.proofs.coverage import problem_of
from dssc_jax.proofs.enclosed_loop import held_sample, sampled
from dssc_jax.proofs.gain_enclosures import functions_at
from dssc_jax.proofs.gains import GAIN_NAMES, gain_hull
from dssc_jax.proofs.problem import problem_from
from dssc_jax.proofs.prove import check_certificate, prove
from dssc_jax.proofs.reach import proved_up_to
from dssc_jax.proofs.sampled_loop import LoopGains, LoopPoint, middle, sensor_weights, state_layout, step_of
from dssc_jax.proofs.verifier import verify_certificate

LOOP = dj.Study.load("studies/certified_margin.toml").override(
    {"plant.k_p": 1.0, "plant.a_p": 0.3, "unmodelled.mu": 0.01, "requirement": [], "draws": 1}
)
CONSTANT = {"kind": "constant", "k_o": 5.0, "tau_av": 0.05, "tau_m": 0.5}
HIGHER = {"plant.zero_dynamics": {"a": [2.0, 1.5], "c": [0.3, 0.1]}}
SINE = {"kind": "sine", "amplitude": 0.2, "period": 2.0 * np.pi}
NOMINAL = {"controller.nominal": {"a": 0.8, "k": 1.1}}


@pytest.fixture(scope="module")
def proved():
    return prove(LOOP)


def exact(point, problem):
    """A at a point by the verifier's own construction."""
    held = held_sample(problem, arb(point.a_p), arb(point.rate))
    matrix = sampled(problem, held, arb(point.k_p), tuple(map(arb, point.gains)))
    return np.array([[float(matrix[i, j].mid()) for j in range(matrix.ncols())] for i in range(matrix.nrows())])


TRANSFER = {"kind": "transfer_function", "mu": 0.02, "numerator": [1.0, -0.3, 0.2], "denominator": [1.0, 1.1, 0.9, 0.4]}
DIRECT = {"kind": "transfer_function", "mu": 0.03, "numerator": [2.0, 0.5], "denominator": [2.0, 1.5]}


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"unmodelled": {"kind": "none"}},
        {"unmodelled": {"kind": "lag", "order": 1, "mu": 0.05}},
        {"unmodelled": TRANSFER},
        {"unmodelled": DIRECT, **NOMINAL},
        {"unmodelled": {"kind": "delay", "samples": 0.4, "memory": 4.0}},
        {"unmodelled": {"kind": "delay", "samples": 2.0, "memory": 4.0}, **HIGHER},
        {"unmodelled": {"kind": "delay", "samples": 2.7, "memory": 4.0}, "sensor": {"kind": "lag", "mu": 0.02}},
        {"sensor": {"kind": "lag", "mu": 0.004}, **NOMINAL},
        {**HIGHER, **NOMINAL},
        {**NOMINAL, "controller.nominal.predictor_term": False, "unmodelled": {"kind": "none"}, **HIGHER},
        {"reference": SINE},
        {"reference": SINE, **NOMINAL, "unmodelled": DIRECT},
        {"reference": SINE, **NOMINAL, "unmodelled": {"kind": "delay", "samples": 1.3, "memory": 4.0}},
    ],
    ids=lambda changes: " ".join(changes),
)
def test_one_sample_is_that_of_the_simulated_loop(changes):
    """Both constructions of A carry the recorded signals from sample to sample, with a constant disturbance."""
    study = LOOP.override(
        {
            "controller.functions": CONSTANT,
            "disturbance": {"kind": "constant", "value": 0.07},
            "loop.duration": 2.0,
            "loop.sample_time": 0.01,
            "loop.substeps": 16,
            **changes,
        }
    )
    run, problem = dj.simulate(study), problem_of(study)
    zeta, memory, n = state_layout(problem)
    gain, tau_m = 1.0 / (5.0 * 0.05), 0.5
    a_n, k_n, term = problem.nominal or (0.0, np.inf, False)
    rate = 1.0 / problem.mu[0] if problem.denominator else 0.0
    point = LoopPoint(1.0, 0.3, rate, LoopGains(gain, gain / tau_m, term / (k_n * tau_m)))
    step = step_of(problem, point, problem.box)
    a = step.a
    np.testing.assert_allclose(exact(point, problem.to_dict()), a, rtol=1e-12, atol=1e-14)

    t = 0.01 * np.arange(201)
    swing = SINE["amplitude"] if any(problem.reference) else 0.0
    y_dot, y_ddot = swing * np.cos(t), -swing * np.sin(t)
    d_r, f = 0.07 - y_ddot - 0.3 * y_dot, (y_ddot + a_n * y_dot) / k_n  # with k_p = 1
    z = np.zeros(n)
    z[0], z[1] = run["e"].values[0], run["y_dot"].values[0] - y_dot[0]
    assert z[:2] == pytest.approx([pair[0] for pair in problem.initial[:2]], abs=1e-12)
    z[zeta], z[n - 2] = d_r[0] * step.jump[zeta], -d_r[0] - f[0]
    z[memory] = sensor_weights(problem)[0] * z[: memory.stop - memory.start]
    z[n - 1] = z[1] + problem.l0 * z[0]
    inside, left = step.b[:, 2:], np.full(n, 3e-7)  # d_r(t) - d_r(t_k) acts between the samples
    for k in range(150):
        assert abs(z[0] - run["e"].values[k]) <= left[0]
        assert abs(z[1] - run["y_dot"].values[k] + y_dot[k]) <= left[1]
        z, left, inside = a @ z, left + np.abs(inside).sum(axis=1), a @ inside
        assert abs(z[n - 2] + d_r[k] + f[k] - run["u_av"].values[k]) <= left[n - 2]
        z += step.jump * (d_r[k + 1] - d_r[k])
        z[n - 2] -= d_r[k + 1] + f[k + 1] - d_r[k] - f[k]
    assert left[0] < 2e-4


def test_a_certificate_is_proved(proved):
    """The set holds the start at e = 0.2 m; the residual lies above what flights with a sine reach."""
    assert proved.complete
    assert proved.share == 1.0
    verdict = check_certificate(json.loads(json.dumps(proved.certificate())))
    assert verdict.proved
    assert (verdict.error, verdict.largest_error) == (proved.error, proved.largest_error)
    study = LOOP.override(
        {"draws": 64, "disturbance.phase": {"uniform": [0.0, 6.28]}, "metrics": {"after": 20.0, "names": ["error_max"]}}
    )
    flown = dj.run(study).dataset["error_max"].values.max()
    print(f"\nproved |e| <= {proved.error:.3e} m, flown {flown:.3e} m, from the start {proved.largest_error:.3f} m")
    assert flown < proved.error < 3.0 * flown
    assert 0.2 < proved.largest_error < 0.3


def test_no_disturbance_of_that_slope_leaves_the_bound(proved):
    """The sign of the impulse response turned in time, which is the worst input of a linear loop."""
    (proof,) = proved.proofs
    product, tau_m = functions_at(proved.problem.to_dict(), (0.0, 0.0), 1, arb(0))
    gain = 1.0 / float(product.mid())
    point = LoopPoint(1.0, 0.3, 100.0, LoopGains(gain, gain / float(tau_m.mid()), 0.0))
    step = step_of(proved.problem, point, proof.box)
    largest, z = 0.0, step.b[:, 0]
    for _ in range(40_000):
        largest += abs(step.rows[0] @ z)
        z = step.a @ z
    print(f"\nworst of the linear loop {largest:.4e} m, proved {proved.error:.4e} m")
    assert largest < proved.error < 1.01 * largest
    assert len(proof.stages) > 1


def falsified(certificate):
    """Certificates that are wrong in one place, with the premise that fails."""
    first = certificate["proofs"][0]["stages"][0]
    n = len(first["p"])

    def with_stage(**changes):
        content = copy.deepcopy(certificate)
        content["proofs"][0]["stages"][0].update(changes)
        return content

    def with_problem(**changes):
        content = copy.deepcopy(certificate)
        content["problem"].update(changes)
        return content

    yield "P2", with_stage(p=[[-x for x in row] for row in first["p"]])
    yield "P7", with_stage(p=np.eye(n).tolist())
    yield "P7", with_stage(rate=100.0 * first["rate"])
    yield "P0", with_stage(rate=-first["rate"])
    yield "P0", with_stage(bounds=first["bounds"][:-1])
    yield "P0", with_stage(bounds=[-x for x in first["bounds"]])
    yield "P7", with_stage(gains=[1.5 * first["gains"][0], *first["gains"][1:]])
    for i, bound in enumerate(first["bounds"]):
        if i != small_gain.EQUIVALENT:  # with which nothing is computed
            yield "P7", with_stage(bounds=[*first["bounds"][:i], 0.5 * bound, *first["bounds"][i + 1 :]])
    yield "P4", with_stage(sigma=0.9 * first["sigma"])
    yield "P7", with_stage(sigma=1.5 * first["sigma"], e=1.5 * first["e"])
    yield "P0", with_stage(method="trust me")
    yield "P5", with_problem(rho=0.15)
    yield "P5", with_problem(rho=0.05)
    yield "P7", with_problem(initial=[[0.21, 0.21], [0.0, 0.0]])
    yield "P7", with_problem(slope=2.0 * certificate["problem"]["slope"])
    yield "P7", with_problem(sample_time=0.02)
    yield "P0", with_problem(slope=-1.0)
    yield "P1", with_problem(mu=[0.005, 0.01])
    yield "P0", with_problem(mu=[0.01, 0.005])
    yield "P0", with_problem(a_p=["0.3", "3"])  # as text, below "3e-1"
    yield "P0", with_problem(form="explicit")
    yield "P0", with_problem(form="conservative")
    yield "P0", with_problem(initial=[[0.0, 0.0]] * 6)  # whose surplus would push d(0) out of the start
    yield "P0", with_problem(zero_c=[1.0])
    yield "P0", with_problem(matched="false")
    yield "P0", with_problem(sample_time=True)
    yield "P0", with_problem(rho=float("inf"))
    yield "P0", with_problem(delay=1.0)  # beside a transfer function
    yield "P0", with_problem(denominator=[1.0, 2.0, 0.0])
    yield "P0", with_problem(numerator=[0.9])
    yield "P0", with_problem(numerator=[1.0] * 4)
    yield "P0", with_problem(sensor_lag=-0.1)
    yield "P0", with_problem(sensor_lag=0.1)  # of which the sets know no memory
    yield "P0", with_problem(reference=[0.0, -1.0, 0.0])
    yield "P7", with_problem(reference=[0.1, 0.1, 0.1])
    yield "P7", with_problem(denominator=[1.0, 2.5, 1.0])
    yield "P0", with_problem(functions={**certificate["problem"]["functions"], "tau_av": 0.1})
    yield "P0", with_problem(functions={**certificate["problem"]["functions"], "delta": -0.5})
    yield "P0", with_stage(sigma=float("nan"))
    yield "P1", with_problem(k_p=[0.9, 1.1])
    content = copy.deepcopy(certificate)
    content["proofs"][0]["stages"][1]["e"] *= 0.5
    yield "P4", content


def falsified_sets(certificate):
    """The same of a certificate that begins with an invariant set."""
    first = certificate["proofs"][0]["stages"][0]
    assert first["method"] == "invariant set"

    def with_stage(**changes):
        content = copy.deepcopy(certificate)
        content["proofs"][0]["stages"][0].update(changes)
        return content

    yield "P2", with_stage(p=[[-x for x in row] for row in first["p"]])
    yield "P6", with_stage(p=np.eye(len(first["p"])).tolist())
    yield "P6", with_stage(multipliers=[0.0 * x for x in first["multipliers"]])
    yield "P6", with_stage(multipliers=[-x for x in first["multipliers"]])
    yield "P6", with_stage(rate=100.0 * first["rate"])
    yield "P4", with_stage(sigma=0.5 * first["sigma"])
    for name, value in (("rho", 0.15), ("initial", [[0.5, 0.5], [0.0, 0.0]])):
        content = copy.deepcopy(certificate)
        content["problem"][name] = value
        yield {"rho": "P5", "initial": "P3"}[name], content


def test_false_certificates_are_rejected():
    """Each names the premise that fails."""
    coarse = LOOP.override({"loop.sample_time": 0.002})
    box = LOOP.override({"plant.k_p": {"uniform": [0.9, 1.1]}, "plant.a_p": {"uniform": [-1.0, 1.0]}})
    certificates = [json.loads(json.dumps(prove(each, boxes=1).certificate())) for each in (coarse, box)]
    assert all(verify_certificate(each).proved for each in certificates)
    for premise, content in (*falsified(certificates[0]), *falsified_sets(certificates[1])):
        verdict = verify_certificate(content)
        assert not verdict.proved
        assert verdict.reason.startswith(f"{premise}: "), (premise, verdict.reason)
        assert verdict.error == float("inf")


def test_a_box_is_proved_or_halved_and_what_is_left_is_named():
    """A box of k_p and mu below the local margin; beyond that, 0.0146 s for the first loop, nothing can be proved."""
    wide = {"controller.functions": CONSTANT, "controller.rho": 2.0, "loop.sample_time": 0.01}
    box = {"unmodelled.mu": {"uniform": [0.0449, 0.0451]}, "plant.k_p": {"uniform": [0.9, 1.1]}}
    easy = prove(LOOP.override({**wide, **box}))
    assert easy.complete
    assert "every plant with k_p in [0.9, 1.1] 1/s and a_p = 0.3 1/s and mu in [0.0449, 0.0451] s" in easy.statement()
    hopeless = prove(LOOP.override({"unmodelled.mu": 0.02}), boxes=4)
    assert not hopeless.complete
    assert hopeless.failures[0].reason == "origin"
    assert hopeless.summary()["error"] is None
    tight = prove(LOOP.override({"controller.rho": 0.09}), boxes=1)
    assert tight.failures[0].reason == "sliding"


@pytest.mark.parametrize(
    "functions",
    [
        {"kind": "square_root", "kappa_o": 20.0, "kappa_m": 1.0, "delta_o": 1.0, "delta_m": 1.0, "tau_av": 0.02},
        {"kind": "approx_sta_1", "kappa1": 4.0, "kappa2": 4.0, "delta": 0.5, "k_o": 20.0},
    ],
)
@pytest.mark.parametrize("form", ["implicit", "conservative"])
def test_both_forms_of_other_functions(functions, form):
    """From 0.2 m, with a lag of 5 ms: flights stay within what is proved."""
    study = LOOP.override(
        {
            "controller.functions": functions,
            "controller.discretisation": form,
            "loop.sample_time": 0.005,
            "unmodelled.mu": 0.005,
            "draws": 16,
            "disturbance.phase": {"uniform": [0.0, 6.28]},
            "metrics": {"after": 0.0, "names": ["error_max", "outside_sliding"]},
        }
    )
    outcome, flown = prove(study.override({"disturbance.phase": 0.0})), dj.run(study).dataset
    assert outcome.complete, outcome.failures
    print(f"\n{functions['kind']}, {form}: {outcome.error:.3g} m, at first {outcome.largest_error:.3g} m")
    assert flown["error_max"].values.max() <= outcome.largest_error
    assert np.all(flown["outside_sliding"].values == 0.0)


def test_an_indefinite_p_does_not_prove_an_unstable_loop():
    """P falls along A, as it must, but it is not positive definite: nothing bounds the tails."""
    stable = {"controller.functions": CONSTANT, "loop.sample_time": 0.005, "controller.rho": 2.0}
    certificate = json.loads(json.dumps(prove(LOOP.override(stable), boxes=1).certificate()))
    assert verify_certificate(certificate).proved
    content = copy.deepcopy(certificate)
    (stage, *_) = content["proofs"][0]["stages"]
    content["proofs"][0]["stages"] = [stage]
    problem = problem_of(LOOP.override({**stable, "controller.functions.tau_m": 0.02}))
    gains = {name: middle(pair) for name, pair in gain_hull(problem, 1e-9, 1e-9).items()}
    a = step_of(problem, LoopPoint(1.0, 0.3, 100.0, LoopGains(gains["k_p"], gains["k_i"], 0.0)), problem.box).a
    values, vectors = np.linalg.eig(a)
    assert np.abs(values).max() > 1.0
    inverse = np.linalg.inv(vectors)
    p = (inverse.conj().T @ np.diag(np.where(np.abs(values) < 1.0, 1.0, -1e6)) @ inverse).real
    content["problem"]["functions"]["tau_m"] = 0.02
    stage.update(p=p.tolist(), rate=0.02, gains=[gains[name] for name in GAIN_NAMES])
    verdict = verify_certificate(content)
    assert not verdict.proved
    assert verdict.reason.startswith("P2: P is not positive definite")


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"sensor": {"kind": "noisy", "velocity_std": 0.01}}, "neither exactly nor through a lag"),
        ({"unmodelled": {"kind": "rate_limit", "rate": 1.0}}, "neither a lag, a transfer function nor a delay"),
        ({"unmodelled": {"kind": "delay", "samples": {"uniform": [0.0, 1.0]}}}, "unmodelled.samples is uncertain"),
        ({"reference": SINE, **HIGHER}, "the reference moves, and the plant has zero dynamics"),
        ({"reference": SINE, "sensor": {"kind": "lag", "mu": 0.01}}, "the reference moves, and the sensor lags"),
        ({"disturbance": {"kind": "step", "value": 0.1, "at": 1.0}}, "no known bound"),
        ({"disturbance": {"kind": "partition", "k_d3": 0.1}}, "depends on the state"),
        ({"controller.discretisation": "explicit"}, "in implicit or conservative form"),
        ({"controller.discretisation": "conservative"}, "depend on e between samples"),
        ({"controller.sign_width": 0.1}, "the sign is smoothed"),
        ({"plant.a_p": {"normal": [1.0, 0.1]}}, "has no bounds"),
        ({"controller.rho": {"uniform": [9.0, 10.0]}}, "controller.rho is uncertain"),
        ({"disturbance": {"kind": "filtered_noise", "std": 0.1, "correlation_time": 1.0}}, "no known bound"),
    ],
)
def test_what_is_not_covered_is_named(changes, reason):
    with pytest.raises(NotCovered, match=reason):
        problem_of(LOOP.override(changes))


def test_a_problem_survives_its_file(proved):
    assert problem_from(json.loads(json.dumps(proved.problem.to_dict()))) == proved.problem


def test_the_last_proved_value_is_bisected(capsys):
    """Between a proved and an unproved value of mu, each loop on its own; beyond a range, or before it, it says so."""
    quick = LOOP.override({"loop.sample_time": 0.005, "controller.functions": CONSTANT, "controller.rho": 2.0})
    reach = proved_up_to(quick, "unmodelled.mu", (0.01, 0.5), log=True)
    assert reach.proved is not None
    assert reach.refused is not None
    assert reach.proved < reach.refused < 1.05 * reach.proved
    assert prove(quick.override({"unmodelled.mu": reach.proved})).complete
    assert reach.statement().startswith(f"Proved up to unmodelled.mu = {reach.proved:.4g}, each value on its own")
    whole = proved_up_to(quick, "unmodelled.mu", (0.01, 0.02))
    assert (whole.proved, whole.refused, len(whole.values)) == (0.02, None, 2)
    none = proved_up_to(quick, "unmodelled.mu", (0.5, 0.6))
    assert (none.proved, none.last) == (None, None)
    assert "Not proved at the safe end" in none.statement()
    with pytest.raises(ConfigError, match="two different positive ends"):
        proved_up_to(quick, "unmodelled.mu", (0.0, 0.5), log=True)
    fixed = ["--set=plant.k_p=1.0", "--set=plant.a_p=0.3", "--set=loop.sample_time=0.005", "--json"]
    assert guarded(["prove", "certified_margin", "--over", "unmodelled.mu=0.5:0.6", *fixed]) == 1
    assert json.loads(capsys.readouterr().out)["proved_up_to"] is None


def test_command(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    fixed = ["--set=plant.k_p=1.0", "--set=plant.a_p=0.3", "--set=unmodelled.mu=0.005"]
    assert guarded(["prove", "certified_margin", *fixed, "--out", "proof.json", "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["proved"]
    assert guarded(["prove", "proof.json"]) == 0
    assert capsys.readouterr().out.startswith("valid: |e| never exceeds")
    assert guarded(["prove", "certified_margin", *fixed, "--set", "unmodelled.mu=0.03"]) == 1
    assert "not stable at sigma = e = 0" in capsys.readouterr().out
    assert guarded(["prove", "mu_robustness"]) == 2
    assert "is outside of what a proof covers" in capsys.readouterr().err
    (tmp_path / "bad.json").write_text("{}")
    assert guarded(["prove", "bad.json"]) == 2


@pytest.mark.parametrize(
    "changes",
    [
        {"unmodelled": {**TRANSFER, "mu": 0.004}},
        {"unmodelled": {"kind": "delay", "samples": 1.6, "memory": 3.0}},
        {"sensor": {"kind": "lag", "mu": 0.003}, "unmodelled.mu": 0.004},
        {"reference": SINE, **NOMINAL, "plant.initial": [0.1, 0.2]},
        {"unmodelled": {"kind": "none"}, **HIGHER, "plant.initial": [0.1, 0.0, 0.05, -0.05]},
    ],
    ids=lambda changes: " ".join(changes),
)
def test_flights_stay_within_what_is_proved(changes):
    """With transfer functions, delays, lagging sensors, moving references and zero dynamics."""
    study = LOOP.override({"loop.sample_time": 0.004, "plant.k_p": {"uniform": [0.98, 1.02]}, **changes})
    outcome = prove(study)
    assert outcome.complete, outcome.failures
    waves = {"draws": 64, "disturbance.phase": {"uniform": [0.0, 6.28]}, "disturbance.period": 6.0}
    early = {"metrics": {"after": 0.0, "names": ["error_max", "outside_sliding"]}}
    flown = dj.run(study.override({**waves, **early, "loop.duration": 20.0})).dataset
    settled = dj.run(study.override({**waves, "metrics": {"after": 25.0, "names": ["error_max"]}})).dataset
    print(f"\n{outcome.error:.3g} m, flown {float(settled['error_max'].max()):.3g} m")
    assert float(flown["error_max"].max()) <= outcome.largest_error
    assert np.all(flown["outside_sliding"].values == 0.0)
    assert float(settled["error_max"].max()) <= outcome.error


@pytest.mark.parametrize("form", ["implicit", "conservative"])
def test_case_2_is_proved_from_40_m(form):
    """Its own gains, whose slope changes by a factor of five on the way."""
    study = dj.Study.load("studies/paper_case2.toml").override(
        {
            "controller.discretisation": form,
            "controller.predictor_start": "matched",
            "disturbance": {"kind": "none"},
            "reference": {"kind": "zero"},
            "unmodelled": {"kind": "lag", "order": 2, "mu": 0.1},
            "requirement": [],
            "metrics": {"after": 0.0, "names": ["error_max", "outside_sliding"]},
        }
    )
    outcome = prove(study, boxes=1)
    assert outcome.complete, outcome.failures
    assert outcome.error < 1e-12
    flown = dj.run(study).dataset
    assert 40.0 <= float(flown["error_max"].max()) <= outcome.largest_error < 200.0
    assert float(flown["outside_sliding"].max()) == 0.0
    first = json.loads(json.dumps(outcome.certificate()))
    assert first["proofs"][0]["stages"][0]["pieces"] > 1
    for pieces, premise in ((1, "P6"), (0, "P0"), (2.0, "P0")):
        content = copy.deepcopy(first)
        content["proofs"][0]["stages"][0]["pieces"] = pieces
        assert verify_certificate(content).reason.startswith(premise)


def test_a_channel_near_hover_is_that_of_the_vehicle():
    """x of the vehicle and of its model, from 0.1 m on, with the same controller."""
    own = {"controller.discretisation": "conservative", "controller.predictor_start": "matched"}
    calm = {"requirement": [], "loop.duration": 12.0, "metrics": {}}
    channel = dj.Study.load("studies/channel_x.toml").override(
        {**calm, "plant.k_p": 1.0, "plant.initial": [0.1, 0.0], "disturbance": {"kind": "none"}}
    )
    start = {"plant.position": [0.1, 0.0, 0.0], "plant.yaw": 0.0}
    still = {"reference": {"kind": "hover"}, "wind": {"kind": "none"}, **start}
    vehicle = dj.Study.load("studies/paper_case1.toml").override({**calm, **own, **still})
    x, model = dj.simulate(vehicle)["x_e"].values, dj.simulate(channel)["e"].values
    assert np.abs(x - model).max() < 0.01 * np.abs(model).max()
