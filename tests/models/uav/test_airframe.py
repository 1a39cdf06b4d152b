"""PX4 files as vehicles: signs against the torques of PX4's own simulator, refusals, a study that flies."""

import math

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.models.uav.airframe import read_airframe
from dssc_jax.models.uav.allocation import geometry
from dssc_jax.models.uav.vehicle import QUADROTOR

PROPERTIES = {"SIH_MASS": 0.72, "SIH_IXX": 0.0016, "SIH_IYY": 0.0017, "SIH_IZZ": 0.0028, "SIH_T_MAX": 9.5}


def rotor_lines(places, coefficients, command="param set-default"):
    """The rotors' part of an airframe script."""
    lines = [f"{command} CA_ROTOR_COUNT {len(places)}"]
    for i, ((x, y), coefficient) in enumerate(zip(places, coefficients, strict=True)):
        lines += [
            f"{command} CA_ROTOR{i}_PX {x}",
            f"{command} CA_ROTOR{i}_PY {y}",
            f"{command} CA_ROTOR{i}_KM {coefficient}",
        ]
    return "\n".join(lines)


QUAD = rotor_lines([(0.1, 0.1), (-0.1, -0.1), (0.1, -0.1), (-0.1, 0.1)], [0.02, 0.02, -0.02, -0.02])
HEX_PLACES = [(0.866, 0.5), (0.0, 1.0), (-0.866, 0.5), (-0.866, -0.5), (0.0, -1.0), (0.866, -0.5)]
HEX = rotor_lines(HEX_PLACES, [0.05, -0.05, 0.05, -0.05, 0.05, -0.05])


def with_properties(text=QUAD, **changed):
    """A script with mass properties."""
    return "\n".join([text, *(f"param set {name} {value}" for name, value in (PROPERTIES | changed).items())])


def vehicle_of(text):
    """The vehicle with the values of a script."""
    own = {name: value for name, value in read_airframe(text, mass=2.0, arm=1.0).vehicle.items() if name != "kind"}
    return QUADROTOR._replace(**{name: tuple(v) if isinstance(v, list) else v for name, v in own.items()})


def simulator_torques(rotors):
    """Roll, pitch, yaw per thrust in PX4's axes, forward-right-down, for an arm of 1: simulator_sih's two layouts."""
    if rotors == 4:
        half = math.sqrt(0.5)
        rows = [[-half, half, half, -half], [half, -half, half, -half], [1, 1, -1, -1]]
    else:
        high = math.sqrt(3.0) / 2.0
        rows = [[-0.5, -1, -0.5, 0.5, 1, 0.5], [high, 0, -high, -high, 0, high], [1, -1, 1, -1, 1, -1]]
    return np.array(rows)


@pytest.mark.parametrize(("text", "arm", "torque"), [(QUAD, 0.1 * math.sqrt(2.0), 0.02), (HEX, 1.0, 0.05)])
def test_torques_are_those_of_px4s_simulator(text, arm, torque):
    vehicle = vehicle_of(text)
    expected = simulator_torques(vehicle.rotors) * np.array([[arm], [-arm], [-torque]])  # forward, left, up
    matrix = geometry(vehicle)
    assert np.allclose(matrix[0], 1.0)
    assert np.allclose(matrix[1:], expected, rtol=1e-4, atol=1e-4 * arm)


def test_mass_properties_are_those_of_the_whole_vehicle():
    text = with_properties(SIH_T_TAU=0.03, SIH_Q_MAX=0.114)
    own = {name: value for name, value in read_airframe(text).vehicle.items() if name != "kind"}
    vehicle = QUADROTOR._replace(**{name: tuple(v) if isinstance(v, list) else v for name, v in own.items()})
    assert vehicle.mass == 0.72
    assert tuple(vehicle.inertia) == (0.0016, 0.0017, 0.0028)
    assert (vehicle.max_thrust, vehicle.motor_lag) == (9.5, 0.03)
    assert vehicle.torque_coefficient == pytest.approx(0.012)  # SIH_Q_MAX over SIH_T_MAX, not CA_ROTORi_KM


def test_a_ground_stations_file_gives_the_same():
    script = with_properties()
    saved = "# Vehicle-Id Component-Id Name Value Type\n" + "\n".join(
        f"1\t1\t{name}\t{value}\t9" for _, _, name, value in (line.split() for line in script.splitlines())
    )
    assert read_airframe(saved) == read_airframe(script)


def test_the_desaturation_is_px4s_default_where_the_file_is_silent():
    assert read_airframe(with_properties()).plant["desaturation"] == "airmode_disabled"
    assert read_airframe(with_properties(), use_px4_cascade=True).plant["desaturation"] == "airmode_disabled"
    assert read_airframe(with_properties(MC_AIRMODE=2)).plant["desaturation"] == "airmode_roll_pitch_yaw"


def test_rotors_on_servos_are_refused_before_their_number():
    with pytest.raises(ConfigError, match="CA_SV_TL_COUNT: must be 0, got 1: the airframe has servos"):
        read_airframe(with_properties(CA_ROTOR_COUNT=3, CA_SV_TL_COUNT=1))
    with pytest.raises(ConfigError, match=r"CA_ROTOR_COUNT: .*fewer fixed rotors than 4"):
        read_airframe(with_properties(CA_ROTOR_COUNT=3))


def test_the_last_setting_counts_and_comments_do_not():
    assert (
        read_airframe(with_properties() + "\nparam set SIH_MASS 0.8\n# param set SIH_MASS 0.9").vehicle["mass"] == 0.8
    )


def test_what_the_file_lacks_is_named():
    notes = " ".join(read_airframe(HEX, mass=2.0, arm=0.4).notes)
    for name in (
        "body_inertia",
        "max_thrust",
        "motor_lag",
        "thrust_coefficient",
        "drag",
        "are ratios",
        "MC_AIRMODE = 0",
    ):
        assert name in notes
    own = " ".join(read_airframe(with_properties(SIH_IXY=1e-4)).notes)
    assert "SIH_MASS" not in own
    assert "are ratios" not in own
    assert "principal axes" in own


@pytest.mark.parametrize(
    ("text", "location", "rule"),
    [
        ("param set MC_ROLL_P 6.5", "", "sets no parameter CA_"),
        (QUAD.replace("COUNT 4", "COUNT 3"), "CA_ROTOR_COUNT", "from 4 to 12, got 3"),
        (QUAD.replace("COUNT 4", "COUNT 1e9"), "CA_ROTOR_COUNT", "at most 1e+06, got 1e+09"),
        (QUAD.replace("COUNT 4", "COUNT 1e6"), "CA_ROTOR_COUNT", "from 4 to 12, got 1e+06"),
        (QUAD.replace("COUNT 4", "COUNT 4.5"), "CA_ROTOR_COUNT", "from 4 to 12, got 4.5"),
        (QUAD.replace("COUNT 4", "COUNT nan"), "CA_ROTOR_COUNT", "must be a finite number"),
        (QUAD.replace("COUNT 4", "COUNT inf"), "CA_ROTOR_COUNT", "must be a finite number"),
        (QUAD + "\nparam set CA_ROTOR1_PX 1e308", "CA_ROTOR1_PX", "must be a finite number of at most"),
        (QUAD + "\nparam set SIH_MASS nan", "SIH_MASS", "must be a finite number"),
        (QUAD + "\nparam set CA_AIRFRAME 2", "CA_AIRFRAME", "got 2"),
        (QUAD, "SIH_MASS", "does not set SIH_MASS, the mass; give it with --mass"),
        (HEX, "SIH_MASS", "--mass KG; positions are ratios"),
        (HEX + "\nparam set SIH_MASS 2", "CA_ROTORi_PX, _PY", "ratios of a generic airframe, not metres"),
        (QUAD + "\nparam set CA_R_REV 255", "CA_R_REV", "reversible"),
        (QUAD + "\nparam set CA_SV_TL_COUNT 2", "CA_SV_TL_COUNT", "servos that tilt"),
        (with_properties(MC_AIRMODE=3), "MC_AIRMODE", "must be 0, 1 or 2"),
        (QUAD + "\nparam set CA_ROTOR0_CT 8", "CA_ROTORi_CT", "same for all rotors"),
        (
            with_properties(QUAD.replace("KM -0.02", "KM 0.02")),
            "CA_ROTORi_KM",
            "cannot command thrust and yaw independently of each other (rank 3 of 4): all turn the same way",
        ),
        ("param set CA_ROTOR_COUNT 4", "CA_ROTORi_PX", "at the centre"),
        (with_properties(SIH_MASS="${MASS}").replace("COUNT 4", "COUNT ${N}"), "CA_ROTOR_COUNT", "got 0"),
    ],
)
def test_what_does_not_map_is_refused(text, location, rule):
    with pytest.raises(ConfigError) as refusal:
        read_airframe(text)
    assert location in refusal.value.where
    assert rule in refusal.value.rule


def test_a_default_is_named_where_a_vehicle_cannot_hover():
    """PX4 leaves out parameters that have their default, so a missing one need not be a fault."""
    text = with_properties(QUAD)
    line = next(line for line in text.splitlines() if "CA_ROTOR3_KM" in line)
    with pytest.raises(ConfigError, match=r"does not set CA_ROTOR3_KM, for which PX4's default 0\.05 counts"):
        read_airframe(text.replace(f"{line}\n", ""))


def test_the_command_prints_a_table_of_a_study_that_flies(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "racer").write_text(with_properties())
    assert guarded(["airframe", "racer"]) == 0
    printed = capsys.readouterr().out
    tables = """
    [controller]
    kind = "pi"
    l0 = 0.5
    k_p = 1.0
    k_i = 0.02
    [reference]
    kind = "hover"
    position = [0.3, 0.2, 1.0]
    """
    head = 'name = "own"\n[loop]\nduration = 30.0\nsample_time = 0.01\n'
    requirement = '[[requirement]]\nmetric = "position_error_max"\nafter = 25.0\nmax = 0.05\n'
    (tmp_path / "own.toml").write_text(head + printed + tables + requirement)
    assert not dj.run(dj.Study.load(tmp_path / "own.toml")).failed.any()
    (tmp_path / "other").write_text("nothing")
    assert guarded(["airframe", "other"]) == 2
    assert "other: sets no parameter" in capsys.readouterr().err


def test_malformed_values_and_missing_places_are_refused():
    broken = QUAD.replace("CA_ROTOR0_PX 0.1", "CA_ROTOR0_PX O.1")
    assert broken != QUAD
    with pytest.raises(dj.ConfigError, match=r"CA_ROTOR0_PX: must be a number, got 'O\.1'"):
        read_airframe(broken, mass=2.0)
    lines = [line for line in QUAD.splitlines() if "CA_ROTOR1_P" not in line and "CA_ROTOR2_P" not in line]
    with pytest.raises(dj.ConfigError, match="CA_ROTOR1_PX, _PY, CA_ROTOR2_PX, _PY: must be set"):
        read_airframe("\n".join(lines), mass=2.0)


def test_a_stated_length_multiplies_positions_and_gains_without_counterpart_are_named():
    plain = read_airframe(QUAD, mass=2.0)
    doubled = read_airframe(QUAD + "\nparam set-default MC_ROLLRATE_P 0.2", mass=2.0, arm=2.0)
    assert doubled.vehicle["arm"] == pytest.approx(2.0 * plain.vehicle["arm"])
    assert "left out, without a counterpart here: MC_ROLLRATE_P" in doubled.notes


def test_a_stated_length_of_1_leaves_all_coordinates():
    heights = "".join(f"\nparam set CA_ROTOR{i}_PZ {-0.03 * i}" for i in range(4))
    plain = read_airframe(QUAD + heights, mass=2.0).vehicle["rotor"]
    assert read_airframe(QUAD + heights, mass=2.0, arm=1.0).vehicle["rotor"] == plain
    assert [rotor["position"][2] for rotor in plain] == pytest.approx([0.0, 0.03, 0.06, 0.09])
    scaled = read_airframe(QUAD + heights, mass=2.0, arm=0.5).vehicle["rotor"]
    assert [rotor["position"][2] for rotor in scaled] == pytest.approx([0.0, 0.015, 0.03, 0.045])


def test_an_inertia_that_the_file_states_in_part_counts():
    estimated = read_airframe(QUAD, mass=2.0).vehicle["body_inertia"]
    found = read_airframe(QUAD + "\nparam set SIH_IXX 0.02", mass=2.0)
    assert found.vehicle["body_inertia"] == [0.02, *estimated[1:]]
    assert "about the other axes is estimated" in " ".join(found.notes)
    assert "the file does not set SIH_IYY, SIH_IZZ" in " ".join(found.notes)
    with pytest.raises(ConfigError, match="SIH_IYY, SIH_IZZ: must be set, too: with estimates of them, SIH_IXX = 1,"):
        read_airframe(QUAD + "\nparam set SIH_IXX 1.0", mass=2.0)
    torque = read_airframe(QUAD + "\nparam set SIH_Q_MAX 0.1", mass=2.0)
    assert "for want of SIH_T_MAX" in " ".join(torque.notes)


def test_the_cascade_takes_the_gains_of_the_file():
    text = QUAD + "\nparam set-default MC_ROLLRATE_P 0.2\nparam set-default MPC_XY_P 0.9"
    found = read_airframe(text, mass=2.0, use_px4_cascade=True)
    assert found.plant["inner_loop"]["kind"] == "px4"
    assert found.plant["inner_loop"]["rate_p"][0] == 0.2
    assert "k_p of [controller], of its .z and of its .psi: MPC_XY_P = 0.9" in found.notes
    table = {"name": "cascade", "loop": {"duration": 1.0, "sample_time": 0.01, "substeps": 8}}
    plant = {"kind": "uav", **found.plant, "vehicle": found.vehicle}
    study = dj.Study.from_table(table | {"plant": plant, "controller": {"kind": "pid", "k_p": 1.0}})
    assert study.template.plant.inner_loop.rate_p[0] == 0.2


def test_rate_of_the_loops_is_that_of_the_file_and_unused_limits_are_named():
    """IMU_GYRO_RATEMAX is the cascade's frequency; what no field takes stands in a note with its value."""
    text = QUAD + "\nparam set-default IMU_GYRO_RATEMAX 800\nparam set-default THR_MDL_FAC 0.3\n"
    cascade = read_airframe(text, mass=2.0, use_px4_cascade=True)
    assert cascade.plant["inner_loop"]["frequency"] == 800.0
    assert any(note == "not used: THR_MDL_FAC = 0.3" for note in cascade.notes)
    plain = read_airframe(text, mass=2.0)
    assert any(note == "not used: THR_MDL_FAC = 0.3, IMU_GYRO_RATEMAX = 800" for note in plain.notes)
    silent = read_airframe(QUAD, mass=2.0, use_px4_cascade=True)
    assert "frequency" not in silent.plant["inner_loop"]
    assert any("400 Hz" in note for note in silent.notes)


def test_a_parameter_without_a_value_is_refused_with_its_line():
    """The next line is none of its words."""
    text = "param set-default CA_ROTOR3_KM   # a value was forgotten\nparam set-default MC_ROLL_P 6.5\n"
    with pytest.raises(dj.ConfigError, match=r"CA_ROTOR3_KM: must be a number, got '' in line 1"):
        read_airframe(text, mass=2.0)


def test_coordinates_that_only_some_rotors_lack_are_named():
    """They count as PX4's default; where all rotors lack one, as level ones do their height, nothing is to be told."""
    text = with_properties()
    assert not any("taken as 0" in warning for warning in read_airframe(text).warnings)
    lines = [line for line in text.splitlines() if "CA_ROTOR2_PY" not in line]
    found = read_airframe("\n".join(lines))
    assert "taken as 0, PX4's default, though other rotors have them: CA_ROTOR2_PY" in found.warnings


def test_gains_of_the_position_control_are_told_with_their_values():
    text = with_properties() + "\nparam set MPC_XY_P 0.95\nparam set MC_YAW_P 2.8"
    notes = read_airframe(text, use_px4_cascade=True).notes
    assert "k_p of [controller], of its .z and of its .psi: MPC_XY_P = 0.95, MC_YAW_P = 2.8" in notes
    assert not any("without a counterpart" in note for note in notes)


def test_units_are_warned_of():
    """Places in millimetres; a vehicle of 2 kg and 0.24 m has nothing to warn of."""
    assert read_airframe(QUAD, mass=2.0).warnings == ()
    lines = []
    for line in QUAD.splitlines():
        words = line.split()
        if len(words) == 4 and words[2].endswith(("_PX", "_PY")):
            line = f"{words[0]} {words[1]} {words[2]} {1000.0 * float(words[3])}"
        lines.append(line)
    first = read_airframe("\n".join(lines), mass=2.0).warnings[0]
    assert first.startswith("mean distance of the rotors from the centre is ")
    with pytest.raises(ConfigError, match="SIH_MASS: must be > 0, got -1 kg"):
        read_airframe(QUAD, mass=-1.0)


def tilted_text(degrees, command):
    """A quadrotor of two pairs of rotors, each tilted across their arms by an angle, that hovers at a command."""
    lines = [QUAD, f"param set MPC_THR_HOVER {command}"]
    for i, (x, y) in enumerate([(1, 1), (-1, -1), (1, -1), (-1, 1)]):
        sign = 1.0 if x * y > 0 else -1.0
        angle = math.radians(degrees[i // 2])
        lines.append(f"param set CA_ROTOR{i}_AX {-sign * y * math.sin(angle) / math.sqrt(2.0)}")
        lines.append(f"param set CA_ROTOR{i}_AY {sign * x * math.sin(angle) / math.sqrt(2.0)}")
        lines.append(f"param set CA_ROTOR{i}_AZ {-math.cos(angle)}")
    return "\n".join(lines)


def test_tilted_rotors_push_more_than_they_lift():
    """By 20 degrees across their arms: hover takes 1/cos of it, and the largest thrust follows from the throttle."""
    vehicle = read_airframe(tilted_text((20.0, 20.0), 0.4), mass=2.0).vehicle
    hover = 2.0 * 9.81 / 4.0 / math.cos(math.radians(20.0))
    assert vehicle["max_thrust"] == pytest.approx(hover / 0.4, rel=1e-12)
    assert vehicle["thrust_coefficient"] == pytest.approx(hover / 500.0**2, rel=1e-12)


@pytest.mark.parametrize("kind", ["px4", "crazyflie"])
@pytest.mark.parametrize("degrees", [(25.0, 25.0), (30.0, 10.0)])
def test_tilted_rotors_hover_at_the_hover_command(kind, degrees):
    """PX4 divides the commands by their mean for a thrust of 1: in hover the rotors have MPC_THR_HOVER in the mean.

    Pairs of different tilts have different commands, so that no yaw moment is left.
    """
    found = read_airframe(tilted_text(degrees, 0.5), mass=2.0, use_px4_cascade=True)
    assert not found.warnings
    inner_loop = {"kind": kind, "thrust_hover": 0.5, "frequency": 400.0}
    plant = {"kind": "uav", **found.plant, "vehicle": found.vehicle, "inner_loop": inner_loop}
    loop = {"duration": 1.0, "sample_time": 0.01, "substeps": 8}
    parts = {"controller": {"kind": "pid", "k_p": 1.0}, "reference": {"kind": "zero"}}
    study = dj.Study.from_table({"name": "tilted", "draws": 1, "loop": loop, "plant": plant} | parts)
    commands = np.array(study.template.plant.first_thrusts) / found.vehicle["max_thrust"]
    assert commands.mean() == pytest.approx(0.5, rel=1e-12)
    assert (np.ptp(commands) > 0.01) == (len(set(degrees)) > 1)
    flight = dj.simulate(study, 0)
    for name in ("x_y", "y_y", "z_y", "psi_y"):
        assert np.abs(flight[name].values).max() < 1e-9


def test_coefficients_are_nominal_where_the_file_and_the_caller_lack_the_rotors():
    """Both are needed: the speed in hover, and the torque of the simulated rotors."""
    text = with_properties(SIH_Q_MAX=0.114)
    assert read_airframe(text).vehicle["rotor_coefficients"] == "nominal"
    assert read_airframe(QUAD, mass=2.0, hover_speed=700.0).vehicle["rotor_coefficients"] == "nominal"
    known = read_airframe(text, hover_speed=700.0)
    assert "rotor_coefficients" not in known.vehicle
    assert known.vehicle["thrust_coefficient"] == pytest.approx(0.72 * 9.81 / 4.0 / 700.0**2, rel=1e-12)
    assert not any("nominal" in note for note in known.notes)
    notes = " ".join(read_airframe(text).notes)
    assert "rotor speeds and the power that a battery gives depend on them, so state hover_power" in notes


def test_a_mixer_is_told():
    with pytest.raises(ConfigError, match=r"sets no parameter CA_\.\.; its rotors are in the mixer .* before 1\.14"):
        read_airframe("sh /etc/init.d/rc.mc_defaults\nset MIXER quad_x\nparam set MC_ROLL_P 7.0")


def test_the_largest_thrust_that_is_assumed_is_printed():
    assert read_airframe(QUAD, mass=2.0).vehicle["max_thrust"] == pytest.approx(2.0 * 2.0 * 9.81 / 4.0, rel=1e-12)


def test_what_is_stated_beside_the_file_is_told_and_what_is_absurd_refused():
    assert any("in place of SIH_MASS" in note for note in read_airframe(with_properties(), mass=2.5).notes)
    with pytest.raises(ConfigError, match=r"MPC_THR_HOVER: must be > 0 and <= 1, got 0"):
        read_airframe(QUAD + "\nparam set MPC_THR_HOVER 0", mass=2.0)
    with pytest.raises(ConfigError, match="CA_ROTOR4_PX, _PY: must be set, to 0 for a rotor at the centre"):
        read_airframe(QUAD + "\nparam set CA_ROTOR_COUNT 5", mass=2.0)
