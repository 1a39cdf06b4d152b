"""Proofs of the sampled loop: matrices against the simulated loop, certificates and what is wrong with false ones."""

import copy
import json

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.design.certification import NotCovered
from dssc_jax.proofs.coverage import problem_of
from dssc_jax.proofs.problem import middle
from dssc_jax.proofs.prove import check_certificate, prove
from dssc_jax.proofs.reach import proved_up_to
from dssc_jax.proofs.search.gains import GAIN_NAMES, gain_hull
from dssc_jax.proofs.search.sampled_loop import LoopGains, LoopPoint, step_of
from dssc_jax.proofs.verifier import small_gain
from dssc_jax.proofs.verifier.gain_enclosures import enclosed_gains
from dssc_jax.proofs.verifier.verdict import verify_certificate
from tests.proofs.cases import CONSTANT, HIGHER, LOOP, SINE
from tests.test_protocols import controller_examples


@pytest.fixture(scope="module")
def proved():
    return prove(LOOP)


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
    gains = enclosed_gains(proved.problem.to_dict(), 1e-15, 1e-15)
    point = LoopPoint(1.0, 0.3, 100.0, LoopGains(float(gains["k_p"].mid()), float(gains["k_i"].mid()), 0.0))
    step = step_of(proved.problem, point, proof.box)
    largest, z = 0.0, step.b[:, 0]
    for _ in range(40_000):
        largest += abs(step.rows.e @ z)
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
    yield "P4", with_stage(change=0.9 * first["bounds"][small_gain.CHANGE])
    yield "P0", with_stage(coordinate="phi_1")  # of functions whose phi_1 depends on e
    yield "P7", with_stage(sigma=1.5 * first["sigma"], e=1.5 * first["e"])
    yield "P0", with_stage(method="trust me")
    yield "P5", with_problem(rho=0.15)
    yield "P5", with_problem(rho=0.05)
    yield "P7", with_problem(initial=[[0.21, 0.21], [0.0, 0.0]])
    yield "P8", with_problem(slope=1.01 * certificate["problem"]["slope"])
    yield "P8", with_problem(level=1.01 * certificate["problem"]["level"])
    yield "P8", with_problem(by_state=[0.0, 0.0, 0.1, 0.0, 0.0])
    yield "P0", with_problem(by_state=[0.0, 0.0, -0.1, 0.0, 0.0])
    yield "P7", with_stage(slope=50.0 * first["slope"])
    yield "P0", with_stage(level=-first["level"])
    yield "P7", with_problem(sample_time=0.02)
    yield "P0", with_problem(slope=-1.0)
    yield "P1", with_problem(mu=[0.005, 0.01])
    yield "P0", with_problem(mu=[0.01, 0.005])
    yield "P0", with_problem(a_p=["0.3", "3"])  # as text, below "3e-1"
    yield "P0", with_problem(form="explicit")
    yield "P0", with_problem(form="conservative")  # of which the stage bounds v in place of q
    yield "P0", with_problem(initial=[[0.0, 0.0]] * 6)  # whose surplus would push d(0) out of the start
    yield "P0", with_problem(zero_c=[1.0])
    yield "P0", with_problem(start="elsewhere")
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
    certificates = [json.loads(json.dumps(prove(study, boxes=1).certificate())) for study in (coarse, box)]
    assert all(verify_certificate(certificate).proved for certificate in certificates)
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
    stage.update(p=(0.5 * (p + p.T)).tolist(), rate=0.02, gains=[gains[name] for name in GAIN_NAMES])
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
        ({"controller.discretisation": "explicit"}, "in implicit or conservative form"),
        (
            {
                "controller.discretisation": "conservative",
                "controller.functions": {"kind": "sta", "kappa1": 4.0, "kappa2": 4.0, "k_o": 20.0},
            },
            "needs a finite slope at sigma = 0; set controller.discretisation = 'implicit'",
        ),
        ({"controller.sign_width": 0.1}, "the sign is smoothed"),
        ({"plant.a_p": {"normal": [1.0, 0.1]}}, "has no bounds"),
        ({"controller.rho": {"uniform": [9.0, 10.0]}}, "controller.rho is uncertain"),
        ({"plant.initial": [1e308, 0.0]}, "initial holds a number beyond 1e\\+100"),
        ({"disturbance": {"kind": "filtered_noise", "std": 0.1, "correlation_time": 1.0}}, "no known bound"),
    ],
)
def test_what_is_not_covered_is_named(changes, reason):
    with pytest.raises(NotCovered, match=reason):
        problem_of(LOOP.override(changes))


UNPROVED = [table for table in controller_examples() if table["kind"] not in ("dssc", "ssc", "pi")]


@pytest.mark.parametrize("table", UNPROVED, ids=lambda table: table["kind"])
def test_a_controller_without_a_theorem_is_named(table):
    with pytest.raises(NotCovered, match="the controller is not DSSC, SSC or PI"):
        problem_of(LOOP.override({"controller": table}))


def test_a_proof_says_that_it_does_not_speak_of_formulas(capsys):
    formula = '[{formula = "always abs(e) < 9"}]'
    settings = ["plant.a_p=0.3", "plant.k_p=1.0", "unmodelled.mu=0.01", f"requirement={formula}", "controller.l0=0.5"]
    guarded(["prove", "certified_margin", "--boxes", "1", *(part for each in settings for part in ("--set", each))])
    assert "proofs neither use nor prove formulas: formula_1" in capsys.readouterr().out


def test_the_last_proved_value_is_bisected(capsys):
    """Between a proved and an unproved value of mu, each loop on its own; beyond a range, or before it, it says so."""
    quick = LOOP.override({"loop.sample_time": 0.005, "controller.functions": CONSTANT, "controller.rho": 2.0})
    reach = proved_up_to(quick, "unmodelled.mu", (0.01, 0.5), log=True)
    assert reach.proved is not None
    assert reach.refused is not None
    assert reach.proved < reach.refused < 1.05 * reach.proved
    assert prove(quick.override({"unmodelled.mu": reach.proved})).complete
    assert reach.statement().startswith(f"Proved up to unmodelled.mu = {reach.proved:.4g}, each value on its own")
    complete_reach = proved_up_to(quick, "unmodelled.mu", (0.01, 0.02))
    assert (complete_reach.proved, complete_reach.refused, len(complete_reach.values)) == (0.02, None, 2)
    failed_reach = proved_up_to(quick, "unmodelled.mu", (0.5, 0.6))
    assert (failed_reach.proved, failed_reach.last) == (None, None)
    assert "Not proved at the safe end" in failed_reach.statement()
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
