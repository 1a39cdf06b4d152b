"""Names in PX4 files: misspelt parameters are told with the right name, and other frames than multirotors refused."""

import pytest

from dssc_jax.core.errors import ConfigError
from dssc_jax.models.uav.airframe import READ, read_airframe
from dssc_jax.models.uav.airframe_names import misspelt_names
from tests.models.uav.test_airframe import QUAD, with_properties


@pytest.mark.parametrize(
    ("misspelt", "right"),
    [
        ("MPC_THR_HOVR", "MPC_THR_HOVER"),  # a character too few
        ("MC_ROLLRATEP", "MC_ROLLRATE_P"),
        ("SIH_IIXX", "SIH_IXX"),  # a character too many
        ("CA_ROTOR2_YP", "CA_ROTOR2_PY"),  # neighbours exchanged
        ("MCP_XY_P", "MPC_XY_P"),
    ],
)
def test_a_slip_is_told_with_the_right_name(misspelt, right):
    text = with_properties().replace(f" {right} ", " UNUSED ")
    assert read_airframe(f"{text}\nparam set {misspelt} 0.1").warnings[-1] == f"{misspelt} is not read: PX4 has {right}"


def test_names_of_px4_are_no_slips():
    """Names that are read, also where they are near, and names that differ by another character."""
    assert misspelt_names([*READ, "MC_YAWRATE_Q", "SIH_KDW", "CA_METHOD", "COM_DISARM_LAND"], READ) == []
    assert {"CA_ROTOR1_PX", "CA_ROTOR11_PX", "MC_ROLLRATE_K", "MC_ROLLRATE_P"} <= set(READ)


def test_of_several_near_names_those_that_do_not_occur_are_told():
    names = [name for name in READ if name != "CA_ROTOR7_KM"]
    assert misspelt_names([*names, "CA_ROTOR_KM"], READ) == ["CA_ROTOR_KM is not read: PX4 has CA_ROTOR7_KM"]


def test_a_refusal_ends_with_the_misspelt_names():
    with pytest.raises(ConfigError, match="the mass; give it with --mass KG; SIH_MAS is not read: PX4 has SIH_MASS"):
        read_airframe(QUAD + "\nparam set SIH_MAS 1.5\nparam set SIH_T_MAX 9.0")
    with pytest.raises(ConfigError, match=r"CA_ROTOR_COUNT: .* got 0.*; CA_ROTOR_CONT is not read"):
        read_airframe(with_properties().replace("CA_ROTOR_COUNT", "CA_ROTOR_CONT"))


@pytest.mark.parametrize(
    ("line", "frame"),
    [
        ("# @class VTOL", "a VTOL"),
        (". ${R}etc/init.d/rc.vtol_defaults", "a VTOL"),
        ("# @class Plane", "a plane"),
        ("sh /etc/init.d/rc.fw_defaults", "a plane"),
        (". ${R}etc/init.d/rc.rover_differential_defaults", "a rover"),
    ],
)
def test_a_script_of_another_frame_is_refused_by_its_line(line, frame):
    with pytest.raises(ConfigError) as refusal:
        read_airframe(f"#!/bin/sh\n{line}\n{with_properties()}")
    assert refusal.value.rule == f"must be the file of a multirotor: its line {line!r} is that of {frame}"


def test_a_script_of_a_multirotor_is_read():
    head = "#!/bin/sh\n# @class Copter\n# as a @class VTOL in hover\n. ${R}etc/init.d/rc.mc_defaults\n"
    assert read_airframe(head + with_properties()) == read_airframe(with_properties())
