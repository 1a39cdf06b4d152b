"""Controllers in C: the bits of what was generated, consent before anything runs."""

import ctypes
import json

import jax
import numpy as np
import pytest

import dssc_jax as dj
from benchmarks.library import command_lanes
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.native.allowed import LOADED
from dssc_jax.core.native.libraries import parameters_without_effect
from dssc_jax.core.numerics import arithmetic
from dssc_jax.engine.sampling import draw
from dssc_jax.flight_code.controller import study_values
from dssc_jax.flight_code.folder import FlightFolder
from dssc_jax.flight_code.template_files import template_text
from tests.cli.conftest import last_json
from tests.conftest import CASE_2, UNCERTAIN
from tests.flight_code.compiling import require
from tests.models.controllers.libraries import built, loaded, table
from tests.mutations import document
from tests.study.test_signals import car

SAMPLES = 200
DRAWS = 48


def commands(study, threads=2, constants=None):
    """What every controller sees and gives, sample by sample, in strict arithmetic."""
    constants = constants or {}
    with arithmetic(study.config.loop.precision):
        lanes = command_lanes(study, constants, SAMPLES)
        indices = np.arange(DRAWS)
        columns = draw(study, indices) | {name: np.full(DRAWS, value) for name, value in constants.items()}
        return jax.tree.leaves(lanes.start((columns, indices), DRAWS, threads)())


def differing_bits(left, right):
    """Numbers that differ in any bit."""
    return sum(
        int(np.sum(a.view(f"u{a.itemsize}") != b.view(f"u{b.itemsize}"))) for a, b in zip(left, right, strict=True)
    )


@pytest.mark.parametrize("precision", [64, 32])
def test_what_is_generated_gives_the_same_bits_when_it_is_loaded_again(place, precision):
    original = dj.Study.from_table(
        {
            **CASE_2,
            "draws": DRAWS,
            "loop": {"duration": 1.0, "sample_time": 0.005, "precision": precision},
            "plant": {"kind": "normal_form", "initial": [4.0, 0.0], "k_p": {"uniform": [0.8, 1.2]}},
            "sensor": {"kind": "noisy", "position_std": 0.001},
            "requirement": [],
        }
    )
    folder = FlightFolder(original)
    for name, text in folder.texts().items():
        (place / name).write_text(text)
    file = built(place, f"generated_{precision}", folder.texts()["case_2_x_controller.c"])
    library = dj.allow_native(file)
    (controller,) = library.controllers
    assert controller.number_size == precision // 8
    gains = {"kind": "library", "file": str(file), "sha256": library.sha256}
    again = dj.Study.from_table({**original.table, "controller": gains})
    assert again.numbers["controller.rho"].value == 1.5
    assert again.numbers["controller.rho"].quantity.interval == "> 0"
    ours = commands(original, constants=study_values(folder.code.controllers))
    theirs = commands(again)
    assert differing_bits(ours, theirs) == 0
    assert float(np.std(ours[2])) > 1e-3
    assert {"sigma_tilde", "flag"} <= set(again.loop.controller[0].info._fields)


def lqg_car(**changes):
    """A quarter car whose LQG controller measures the travel and the tyre's force."""
    gains = {"kind": "lqg", "command_weight": 1e-6, "state_weights": [100.0, 1.0, 10000.0, 0.5]}
    gains |= {"disturbance_std": [20.0, 0.1], "state_std": [1e-4, 1e-3, 1e-5, 1e-2], "signal_std": [0.001, 1.0]}
    sensor = {"measures": ["travel", "tyre_force"], "travel": {"kind": "noisy", "position_std": 1e-3}}
    return car(controller=gains, sensor=sensor, draws=DRAWS, seed=2, **changes)


def test_generated_code_that_takes_measured_signals_gives_the_same_bits(place):
    """Each signal by its name, also where the study measures more, in another order."""
    original = lqg_car()
    folder = FlightFolder(original)
    for name, text in folder.texts().items():
        (place / name).write_text(text)
    (source,) = [text for name, text in folder.texts().items() if name.endswith("_controller.c")]
    library = dj.allow_native(built(place, "signals", source))
    (controller,) = library.controllers
    taken = [(signal.name, signal.quantity.unit) for signal in controller.measured]
    assert taken == [("travel", "m"), ("tyre_force", "N")]
    gains = {"kind": "library", "file": str(place / "signals.so"), "sha256": library.sha256}
    again = dj.Study.from_table({**original.table, "controller": gains})
    assert differing_bits(commands(original, constants=study_values(folder.code.controllers)), commands(again)) == 0
    turned = again.override({"sensor": {"measures": ["tyre_force", "acceleration", "travel"]}})
    straight = again.override({"sensor": {"measures": ["travel", "tyre_force"]}})
    assert np.std(dj.simulate(turned, 0)["u"].values) > 1.0
    np.testing.assert_array_equal(dj.simulate(turned, 0)["u"].values, dj.simulate(straight, 0)["u"].values)
    with pytest.raises(ConfigError, match="takes the measured signal 'tyre_force', which is not in "):
        again.override({"sensor": {"measures": ["travel"]}})
    outputs = original.table["plant"]["outputs"]
    milli = {**outputs, "travel": {**outputs["travel"], "unit": "mm"}}
    with pytest.raises(ConfigError, match="takes 'travel' in m, and the study measures it in mm"):
        again.override({"plant.outputs": milli})
    unknown = {**outputs, "travel": {"c": outputs["travel"]["c"]}}
    assert again.override({"plant.outputs": unknown}).loop.measures[0].unit == ""


def test_a_library_runs_beside_measured_signals(template):
    gains = {"kind": "library", "file": str(template), "sha256": dj.allow_native(template).sha256}
    alone = car(controller=gains, loop={"duration": 0.5, "sample_time": 0.01})
    beside = alone.override({"sensor": {"measures": ["travel"]}})
    np.testing.assert_array_equal(dj.simulate(alone)["u"].values, dj.simulate(beside)["u"].values)


def test_threads_do_not_matter(study):
    assert differing_bits(commands(study, threads=1), commands(study, threads=2)) == 0


def test_the_loop_calls_what_the_file_holds(study, template):
    """The commands of a trajectory are those of the file, called here by structures of our own."""
    values = {"plant.k_p": 1.1, "controller.k_p": 2.5, "unmodelled.mu": 0.05}
    dataset = dj.simulate(study.override({**values, "reference": {"kind": "zero"}}), 0)
    numbers = ctypes.c_double

    def structure(*names):
        return type("Structure", (ctypes.Structure,), {"_fields_": [(name, numbers) for name in names]})

    parameters = structure("k_p", "k_d", "limit")
    fields = [("parameters", parameters), ("filtered", numbers), ("started", ctypes.c_bool)]
    controller = type("Controller", (ctypes.Structure,), {"_fields_": fields})()
    command, telemetry = structure("u", "u_n", "u_p")(), structure("error")()
    library = ctypes.CDLL(str(template))
    library.my_init(ctypes.byref(controller))
    assert (controller.parameters.k_p, controller.parameters.k_d, controller.parameters.limit) == (4.0, 3.0, 10.0)
    controller.parameters.k_p = 2.5
    library.my_reset(ctypes.byref(controller))
    for k in range(dataset.sizes["t"]):
        measured = structure("y", "y_dot")(float(dataset["y"][k]), float(dataset["y_dot"][k]))
        desired = structure("y", "y_dot", "y_ddot")(0.0, 0.0, 0.0)
        library.my_step(ctypes.byref(controller), measured, desired, ctypes.byref(command), ctypes.byref(telemetry))
        assert command.u == pytest.approx(float(dataset["u"][k]), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("without", [False, True])
def test_a_sample_without_telemetry_gives_all_else(place, without):
    """The flag tells here which step ran; the telemetry is that of the step with it."""
    text = template_text("library.c").replace("return 0;", "return telemetry == NULL ? 7 : 0;")
    if not without:
        text = text.replace("#define DSSC_JAX_OPTIONAL_TELEMETRY", "")
    flown = loaded(built(place, f"telemetry_{without}", text), k_p=5.0)
    signals = dj.simulate(flown, 0)
    assert np.all(signals["flag"] == (7.0 if without else 0.0))
    np.testing.assert_array_equal(signals["error"], signals["y_ref"] - signals["y_measured"])


def test_trial_flights_begin_within_narrow_limits(place):
    """Else every command is at its limit, and the integral gain seems to have no effect."""
    gains = {"kind": "pid", "k_p": 8.0, "k_i": 3.0, "k_d": 4.0, "filter": 0.03, "low": -2.0, "high": 1.5}
    study = dj.Study.from_table({**UNCERTAIN, "name": "narrow", "sweep": {}, "controller": gains})
    texts = FlightFolder(study).texts()
    (place / "narrow_controller.h").write_text(texts["narrow_controller.h"])
    library = dj.allow_native(built(place, "narrow", texts["narrow_controller.c"]))
    assert "k_i" not in parameters_without_effect(library.controllers[0])


def test_plain_xla_is_the_reference(study, tmp_path, monkeypatch):
    ours = dj.run(study, tmp_path / "lanes")
    monkeypatch.setenv("DSSC_JAX_KERNEL", "scan")
    theirs = dj.run(study, tmp_path / "scan")
    for name in ("error_rms", "command_tv", "outcome"):
        np.testing.assert_allclose(ours.dataset[name], theirs.dataset[name], rtol=1e-12)
    assert dj.verify(ours).verdict == "agrees"


# Consent


def test_nothing_is_loaded_without_consent(place, monkeypatch, capsys):
    """The message names file and digest; a result is read without the code, and its study cannot be simulated."""
    file = built(place, "gated", template_text("library.c").replace("k_p = 4;", "k_p = 4.25;"))
    monkeypatch.chdir(place)
    (place / "gated.toml").write_bytes(document(table("gated.so")))
    with pytest.raises(ConfigError, match=r"'gated.so' is native code that was not loaded \(SHA-256 [0-9a-f]{64}\)"):
        dj.Study.load("gated.toml")
    assert guarded(["run", "gated.toml"]) == 2
    assert "--allow-native loads it" in capsys.readouterr().err
    assert guarded(["run", "gated.toml", "--allow-native", "--out", "gated", "--json"]) == 0
    printed = capsys.readouterr()
    (digest,) = (key for key, library in LOADED.items() if library.file == str(file))
    assert f"this study runs native code gated.so, SHA-256 {digest}" in printed.err
    code = json.loads((place / "gated" / "manifest.json").read_text())["code"]
    assert code == {"gated.so": {"file": str(file), "sha256": digest}}

    monkeypatch.delitem(LOADED, digest)
    stored = dj.load("gated")
    assert "controller.k_p" in stored.study.numbers
    with pytest.raises(ConfigError, match="allow_native"):
        dj.replay(stored, 1)
    assert guarded(["replay", "gated", "--draw", "1"]) == 2
    assert guarded(["replay", "gated", "--draw", "1", "--allow-native"]) == 0

    monkeypatch.delitem(LOADED, digest)
    built(place, "gated", template_text("library.c").replace("k_p = 4;", "k_p = 4.5;"))
    assert guarded(["replay", "gated", "--draw", "1", "--allow-native"]) == 2
    assert "has changed: its SHA-256 digest is" in capsys.readouterr().err


def test_another_file_does_not_keep_the_digest(place, study):
    other = built(place, "other", template_text("library.c").replace("k_p = 4;", "k_p = 5;"))
    library = dj.allow_native(other)
    changed = study.override({"controller.file": str(other)})
    assert changed.table["controller"]["sha256"] == library.sha256 != study.table["controller"]["sha256"]
    assert changed.hash != study.hash


def test_tables_of_a_comparison_get_digests(place, template, monkeypatch):
    """A table without a kind has that of the study's controller."""
    monkeypatch.chdir(place)
    content = {
        **table("my.so"),
        "compare": {"stiff": {"file": "my.so", "k_p": 6.0}, "pid": {"kind": "pid", "k_p": 1.0}},
    }
    (place / "compared.toml").write_bytes(document(content))
    library = dj.allow_native(template)
    tables = dj.Study.load("compared.toml").table
    assert tables["compare"]["stiff"]["sha256"] == tables["controller"]["sha256"] == library.sha256
    assert "sha256" not in tables["compare"]["pid"]


# The command


def test_the_command_builds_and_shows(tmp_path, monkeypatch, capsys):
    require("cc")
    monkeypatch.chdir(tmp_path)
    assert guarded(["library", "--template", "own.c"]) == 0
    assert guarded(["library", "--template", "own.c"]) == 2
    capsys.readouterr()
    assert guarded(["library", "own.c", "--json"]) == 0
    shown = last_json(capsys)["controllers"]["my"]
    assert shown["parameters"]["k_p"]["default"] == 4.0
    assert shown["telemetry"] == {"error": "y"}
    assert shown["samples_not_finite"] == 0
    assert guarded(["library", "own.so"]) == 0
    printed = capsys.readouterr().out
    assert "file = 'own.so'" in printed
    assert "not finite" not in printed
    lost = (tmp_path / "own.c").read_text().replace("fmin(", "0.0 / 0.0 + fmin(")
    (tmp_path / "lost.c").write_text(lost)
    assert guarded(["library", "lost.c"]) == 0
    assert "not finite in 64 of 64 samples" in capsys.readouterr().out
    (tmp_path / "odd.c").write_text((tmp_path / "own.c").read_text().replace("limit = 10;", "limit = -1;"))
    assert guarded(["library", "odd.c"]) == 0
    assert "the default of limit, -1, is not >= 0: a study has to state it" in capsys.readouterr().out
    cached = (tmp_path / "own.c").read_text().replace("p->k_p * error", "kept * error")
    cached = cached.replace(
        "    const real error", "    static real kept;\n    kept = kept ? kept : p->k_p;\n    const real error"
    )
    (tmp_path / "cached.c").write_text(cached)
    assert guarded(["library", "cached.c"]) == 0
    told = capsys.readouterr().out
    assert "k_p changes no command of a trial flight" in told
    assert "k_d changes" not in told
    assert "limit changes" not in told
    (tmp_path / "own.c").write_text((tmp_path / "own.c").read_text().replace("fmin(", "fmin_of("))
    assert guarded(["library", "own.c"]) == 2
    assert "does not compile" in capsys.readouterr().err
    assert guarded(["library"]) == 2
