"""The monitor of a flight: right flags in Python, the same bits in C, and refused certificates."""

import ctypes
import json
import re
import subprocess

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from benchmarks.flight_premises import earliest, first_raised
from dssc_jax.core.numerics import arithmetic
from dssc_jax.flight_code.certified_premises import certified_premises
from dssc_jax.flight_code.folder import FlightFolder
from dssc_jax.flight_code.monitor import NEVER, initial_monitor, monitor
from dssc_jax.flight_code.premises import DisturbancePremises, rounded_outwards, rounded_up
from dssc_jax.flight_code.seen_disturbance import initial_seen, mean_disturbance, see
from dssc_jax.flight_code.traced_monitor import monitor_state, sample_shape, typed
from dssc_jax.lanes.lanes import CompiledLanes
from tests.flight_code.compiling import FLAGS, made, require
from tests.flight_code.conftest import AXIS, HOVER, PROVED


@pytest.mark.parametrize(("name", "draws", "samples"), [("axis", 32, 20_000), ("vehicle", 8, 4000)])
def test_flights_within_the_premises_raise_no_flag(folders, name, draws, samples):
    assert first_raised(folders[name], {}, draws, samples) == [{}] * draws


@pytest.mark.parametrize(
    ("name", "changes", "expected", "samples"),
    [
        ("axis", {"plant.initial": [0.3, 0.0]}, {"start", "e"}, 2000),
        ("axis", {"plant.initial": [0.2, 0.05]}, {"start"}, 2000),
        ("axis", {"disturbance.amplitude": 0.2}, {"disturbance"}, 8000),
        ("axis", {"disturbance.period": 1.0}, {"disturbance_slope"}, 8000),
        ("axis", {"plant.k_p": 0.5}, {"disturbance_slope"}, 8000),
        ("vehicle", {"plant.position": [0.5, 0.0, 0.0]}, {"start"}, 500),
        ("vehicle", {"plant.velocity": [0.0, 0.0, 0.1]}, {"start", "z_e_dot", "z_sigma"}, 500),
        ("vehicle", {"plant.vehicle.mass": 10.6}, {"rotor_low"}, 500),
        ("vehicle", {"wind.speed": 6.5}, {"tilt", "x_sigma_slope", "y_sigma_slope", "z_sigma_slope"}, 6000),
    ],
)
def test_flights_that_leave_one_premise_raise_its_flag_first(folders, name, changes, expected, samples):
    """Of the flags that a premise may raise, and no others, the first ones are raised in every flight."""
    for found in first_raised(folders[name], changes, 8, samples):
        assert found
        first = set(earliest(found))
        assert first <= expected, (first, found)
        if "start" in expected:
            assert first == expected


def test_a_gust_that_is_too_sudden_is_seen_at_the_next_sample(folders):
    """A wind of twice the speed changes sigma faster than any wind within the bounds can, at once."""
    for found in first_raised(folders["vehicle"], {"wind.speed": 10.0}, 8, 3000):
        assert {flag for flag, sample in found.items() if sample == 1} & {"x_sigma_slope", "y_sigma_slope"}


def test_a_loop_that_does_not_slide_is_flagged(folders):
    """rho is that of the controller in flight; the certificate's loop never reaches it."""
    for found in first_raised(folders["axis"], {"controller.rho": 0.05}, 4, 2000):
        assert "sliding" in found
        assert min(found, key=found.get) == "sliding"


def stepper(folder):
    """The monitor of a folder, compiled by XLA, and a sample within the bounds."""
    premises = folder.monitor.premises

    def step(state, sample):
        after, current = monitor(premises, state, sample)
        return typed(after), current

    zero = jax.tree.map(lambda leaf: jnp.zeros((), leaf.dtype), sample_shape(premises))
    return jax.jit(step), typed(initial_monitor(premises)), zero


def bit(folder, name):
    """The value of a flag's bit."""
    return 1 << [flag.name for flag in folder.monitor.premises.flags()].index(name)


def test_missing_numbers_raise_and_clear_nothing(folders):
    folder = folders["vehicle"]
    hover = (folder.monitor.premises.rotors[0] + folder.monitor.premises.rotors[1]) / 2.0
    with arithmetic():
        step, state, sample = stepper(folder)
        sample = sample._replace(rotor=(hover,) * len(sample.rotor))
        missing = jax.tree.map(lambda leaf: leaf * np.nan, sample)
        for unknown in (missing, jax.tree.map(lambda leaf: leaf * np.nan + np.inf, sample)):
            state, current = step(state, unknown)
            assert int(current) == int(state.latched) == 0
        assert float(state.started) == 0.0  # the start is compared at the first sample that is known
        tilted = sample._replace(tilt=0.2)
        state, current = step(state, tilted)
        assert int(current) == int(state.latched) == bit(folder, "tilt")
        state, current = step(state, missing)
        assert int(current) == 0
        assert int(state.latched) == bit(folder, "tilt")
        names = [flag.name for flag in folder.monitor.premises.flags()]
        assert {name: int(k) for name, k in zip(names, state.first, strict=True) if int(k) != NEVER} == {"tilt": 2}
        assert int(state.sample) == 4


def test_the_slope_of_sigma_counts_the_missing_samples(folders):
    """After n missing samples sigma may have changed n + 1 times as much."""
    folder = folders["vehicle"]
    channel = folder.monitor.premises.channels[2]
    change = channel.sigma_slope * folder.monitor.premises.sample_time
    for missing, factor, raised in [(0, 0.99, False), (0, 1.01, True), (4, 4.99, False), (4, 5.01, True)]:
        with arithmetic():
            step, state, sample = stepper(folder)
            sample = sample._replace(rotor=(26.7,) * len(sample.rotor))
            state, _ = step(state, sample)
            for _ in range(missing):
                unknown = sample.channels[2]._replace(y=jnp.nan)
                channels = (*sample.channels[:2], unknown, sample.channels[3])
                state, current = step(state, sample._replace(channels=channels))
                assert int(current) == 0
            moved = sample.channels[2]._replace(y_dot=factor * change)
            _, current = step(state, sample._replace(channels=(*sample.channels[:2], moved, sample.channels[3])))
        assert bool(int(current) & bit(folder, "z_sigma_slope")) == raised


def test_yaw_is_wrapped(folders):
    """A turn is no error."""
    folder = folders["vehicle"]
    with arithmetic():
        step, state, sample = stepper(folder)
        sample = sample._replace(rotor=(26.7,) * len(sample.rotor))
        turned = sample.channels[3]._replace(y=np.pi - 1e-5, y_ref=-np.pi + 1e-5)
        _, current = step(state, sample._replace(channels=(*sample.channels[:3], turned)))
        names = [flag.name for flag in folder.monitor.premises.flags()]
        raised = {name for i, name in enumerate(names) if int(current) >> i & 1}
    assert raised == {"start"}  # the error of 2e-5 rad is within the bounds, but not where the flight may start


@pytest.mark.parametrize("order", [0, 1, 2])
def test_the_interval_holds_the_disturbance(order):
    """An exact simulation by SciPy, with plants and lags from within their intervals; d is constant within a sample."""
    dt, rng = 0.01, np.random.default_rng(order)
    premises = DisturbancePremises(0.5, 1.0, (0.8, 1.3), (-0.5, 1.0), (0.02, 0.03) if order else (0.0, 0.0), order)
    for trial in range(6):
        exact = trial == 0 and DisturbancePremises(0.5, 1.0, (1.0, 1.0), (0.4, 0.4), (0.02, 0.02), order)
        known = exact or premises
        k_p, a_p = rng.uniform(*known.k_p), rng.uniform(*known.a_p)
        mu = rng.uniform(*known.mu) if order else 0.0
        size = 2 + order
        slopes = np.zeros((size + 2, size + 2))  # y, y', lags, u, d
        slopes[0, 1], slopes[1, 1], slopes[1, -1] = 1.0, -a_p, k_p
        slopes[1, 2 if order == 1 else 3 if order == 2 else size] = k_p
        for lag in range(order):
            slopes[2 + lag, 2 + lag] = -1.0 / mu
            slopes[2 + lag, size if lag == 0 else 1 + lag] += 1.0 / mu
        advance = scipy.linalg.expm(slopes * dt)
        state = np.zeros(size + 2)
        with arithmetic():
            enclose = jax.jit(lambda s, y, v, known=known: mean_disturbance(known, s, y, v, dt))
            step = jax.jit(lambda s, y, v, u, known=known: see(known, s, y, v, jnp.asarray(True), u, dt))
            seen = jax.tree.map(jnp.asarray, initial_seen(known))
            for k in range(200):
                if k:
                    low, high = (float(end) for end in enclose(seen, state[0], state[1]))
                    assert low <= state[-1] <= high
                    if exact:
                        assert high - low < 1e-9
                state[-2] = -state[-1] + 0.3 * np.sin(0.2 * k) + 0.1 * rng.normal()
                seen, flags = step(seen, state[0], state[1], state[-2])
                if k > 1:
                    assert not bool(flags.level)
                    assert not bool(flags.slope)
                state[-1] = 0.45 * np.sin(2.0 * (k * dt))
                state = advance @ state


def test_bounds_are_rounded_outwards():
    single = np.dtype(np.float32)
    rng = np.random.default_rng(0)
    for value in rng.normal(size=1000):
        assert rounded_up(value, single) >= value
        assert np.float32(rounded_up(value, single)) == rounded_up(value, single)
        assert np.nextafter(np.float32(rounded_up(value, single)), np.float32(-np.inf)) < value
        low, high = rounded_outwards((value, value), single)
        assert low <= value <= high
    assert rounded_up(0.5, single) == 0.5


def c_monitor(folder, place):
    """The compiled monitor as a function of its state and its sample, both as flat lists of numbers."""
    require("cc")
    traced = folder.monitor
    for name, text in folder.texts().items():
        (place / name).write_text(text)
    library = place / "monitor.so"
    source = str(place / f"{traced.prefix}.c")
    subprocess.run(["cc", *FLAGS, "-fPIC", "-shared", source, "-o", str(library), "-lm"], check=True)
    number = ctypes.c_float if traced.precision == 32 else ctypes.c_double
    count = len(traced.premises.flags())
    memory = type("Memory", (ctypes.Structure,), {"_fields_": [(name, number) for name in traced.memories]})
    fields = [("current", ctypes.c_uint32), ("latched", ctypes.c_uint32), ("sample", ctypes.c_int32)]
    fields += [("first", ctypes.c_int32 * count), ("memory", memory)]
    state_type = type("State", (ctypes.Structure,), {"_fields_": fields})
    sample_type = type("Sample", (ctypes.Structure,), {"_fields_": [(name, number) for name in traced.inputs]})
    functions = ctypes.CDLL(str(library))

    def flat(state):
        numbers = [getattr(state.memory, name) for name in traced.memories]
        return [state.latched, state.sample, *state.first, *numbers, state.current]

    def step(leaves, sample):
        state = state_type(
            0, int(leaves[0]), int(leaves[1]), (ctypes.c_int32 * count)(*map(int, leaves[2 : 2 + count]))
        )
        for name, value in zip(traced.memories, leaves[2 + count :], strict=True):
            setattr(state.memory, name, value)
        getattr(functions, f"{traced.prefix}_step")(ctypes.byref(state), ctypes.byref(sample_type(*sample)))
        return flat(state)

    def begin():
        state = state_type()
        getattr(functions, f"{traced.prefix}_init")(ctypes.byref(state))
        return flat(state)

    return step, begin


def hostile(rng, shape, real):
    """Numbers of all sizes; some are zero, infinite or NaN."""
    numbers = rng.normal(size=shape) * 10.0 ** rng.integers(-4, 2, size=shape)
    odd = rng.random(shape)
    numbers[odd < 0.02] = np.nan
    numbers[(odd > 0.02) & (odd < 0.03)] = np.inf
    numbers[(odd > 0.03) & (odd < 0.08)] = 0.0
    return numbers.astype(real)


@pytest.mark.parametrize("precision", [64, 32])
@pytest.mark.parametrize("name", ["axis", "vehicle"])
def test_c_has_the_bits_of_jax_in_any_state(folders, certificates, name, precision, tmp_path):
    study = PROVED[name].override({"loop.precision": precision})
    premises = certified_premises(study, json.loads(certificates[name].read_text()), name)
    folder = FlightFolder(study, premises)
    traced = folder.monitor
    count, flags = 400, len(premises.flags())
    rng = np.random.default_rng(7)
    step, begin = c_monitor(folder, tmp_path)
    with arithmetic(precision):
        shapes = (monitor_state(traced.premises), sample_shape(traced.premises))
        start = jax.tree.leaves(typed(initial_monitor(traced.premises)))

        def lane(state, sample):
            after, current = monitor(traced.premises, state, sample)
            return typed(after), current

        lanes = CompiledLanes(lane, *shapes, strict=True)
        columns = []
        for leaf in jax.tree.leaves(shapes):
            if leaf.dtype.kind == "f":
                columns.append(hostile(rng, count, leaf.dtype))
            else:
                columns.append(
                    rng.integers(0 if leaf.dtype.kind == "u" else -1, 2 ** min(flags, 20), count, leaf.dtype)
                )
        arguments = jax.tree.unflatten(jax.tree.structure(shapes), columns)
        results = jax.tree.leaves(lanes.start(arguments, count, 1)())
    assert [float(leaf) for leaf in start] == [float(number) for number in begin()[:-1]]
    states = len(columns) - len(traced.inputs)
    raised = 0
    for i in range(count):
        leaves = [column[i] for column in columns]
        answer = step(leaves[:states], leaves[states:])
        for got, expected in zip(answer, results, strict=True):
            wanted = expected[i]
            assert np.asarray(got, wanted.dtype).tobytes() == wanted.tobytes() or (np.isnan(got) and np.isnan(wanted))
        raised |= answer[-1]
    assert raised.bit_count() > 0.7 * flags


@pytest.mark.parametrize("precision", [64, 32])
@pytest.mark.parametrize(
    ("target", "tools"),
    [
        ("monitor-check", ["cc"]),
        ("monitor-sanitized", ["cc"]),
        ("monitor-cpp", ["c++"]),
        ("monitor-clang", ["clang"]),
        ("monitor-arm64", ["aarch64-linux-gnu-gcc", "qemu-aarch64"]),
        ("monitor-armhf", ["arm-linux-gnueabihf-gcc", "qemu-arm"]),
    ],
)
def test_recorded_flights_have_the_same_bits(benches, precision, target, tools):
    require("make", *tools)
    printed = made(benches[precision], target)
    (compared, raised) = re.findall(
        r"^monitor: 0 of (\d+) values differ, 4 flights, flags raised: (0x\w+)", printed, re.M
    )[0]
    assert int(compared) == 4 * 1000 * (2 + 9)  # both words, the start, sigma and gap of four channels
    assert int(raised, 16).bit_count() > 16


@pytest.fixture(scope="module")
def benches(certificates, tmp_path_factory):
    """The folders of the vehicle in both precisions, with recordings."""
    content = json.loads(certificates["vehicle"].read_text())
    found = {}
    for precision in (64, 32):
        found[precision] = tmp_path_factory.mktemp(f"vehicle{precision}")
        study = HOVER.override({"loop.precision": precision})
        folder = FlightFolder(study, certified_premises(study, content, "vehicle"))
        for name, text in folder.texts().items():
            (found[precision] / name).write_text(text)
        (found[precision] / "monitored.bin").write_bytes(b"".join(folder.monitor_recording(2, 1000)))
    return found


def test_a_wrong_monitor_is_detected(benches, tmp_path):
    """A sign turned by hand."""
    require("cc", "make")
    for path in benches[64].iterdir():
        if path.is_file():
            (tmp_path / path.name).write_bytes(path.read_bytes())
    source = tmp_path / "hover_wind_monitor.c"
    text = source.read_text()
    assert "seen->sliding_margin" not in text
    assert "seen->x_sliding_margin < 0.0" in text
    source.write_text(text.replace("seen->x_sliding_margin < 0.0", "seen->x_sliding_margin > 0.0"))
    (tmp_path / "monitor-bench").unlink(missing_ok=True)
    assert "differs: current of flight 0, sample 0" in made(tmp_path, "monitor-check", fails=True)


def test_every_flag_has_a_sentence_in_header_and_readme(folders):
    for folder in folders.values():
        texts = folder.texts()
        header = " ".join(texts[f"{folder.monitor.prefix}.h"].replace("\n *", "").split())
        for number, flag in enumerate(folder.monitor.premises.flags()):
            name = f"{folder.monitor.prefix}_{flag.name}".upper()
            assert f"#define {name} 0x{1 << number:x}u" in header
            assert flag.sentence in header
            assert f"* `{name}`: {flag.sentence}" in texts["README.md"]


def test_without_a_certificate_nothing_is_added():
    folder = FlightFolder(AXIS)
    texts = folder.texts()
    assert not [name for name in texts if "monitor" in name]
    assert "monitor" not in texts["Makefile"] + texts["README.md"]
    assert "monitor" not in folder.summary()
