"""The page on logs of PX4: its files and its commands give its numbers."""

import re
from pathlib import Path

import pytest

from dssc_jax.cli.main import guarded

pytest.importorskip("pyulog")
pytestmark = pytest.mark.filterwarnings(
    "ignore::dssc_jax.flight_logs.reading.ulog.LogWarning"
)  # of the estimator's jumps

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "logs.md").read_text()
TAKEOFF = DOCS / "logs" / "sitl_takeoff.ulg"
FILES = ("px4.py", "climb.toml", "columns.toml")
SETPOINTS = {"setpoint.csv": "vehicle_local_position_setpoint", "trajectory.csv": "trajectory_setpoint"}
COMPARISON = ["compare-log", "climb.toml", str(TAKEOFF), "--columns", "columns.toml", "--allow-local"]
TOLERANCE = 0.02  # of the page's numbers: processors round otherwise


def page_numbers(start: str) -> list[float]:
    """The numbers of the page's line of output that begins so."""
    match = re.search(rf"^    {re.escape(start)}.*$", PAGE, re.MULTILINE)
    assert match is not None, start
    return numbers_of(match.group())


def numbers_of(line: str) -> list[float]:
    return [float(number) for number in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", line)]


def printed_numbers(output: str, start: str) -> list[float]:
    lines = [line.strip(" │|") for line in output.splitlines() if start in line]
    assert lines, output
    return numbers_of(lines[0][lines[0].index(start) :])


@pytest.fixture
def climb(tmp_path, monkeypatch):
    """The folder with the page's files, and the setpoints of the flight."""
    monkeypatch.chdir(tmp_path)
    for name in FILES:
        block = re.search(rf"```\w+\n# {re.escape(name)}\n(.*?)```", PAGE, re.DOTALL)
        assert block is not None, name
        (tmp_path / name).write_text(block.group(1))
    for file, topic in SETPOINTS.items():
        assert guarded(["log", str(TAKEOFF), "--topic", topic, "--start", "19.0", "--csv", file]) == 0


@pytest.mark.usefixtures("climb")
def test_the_climb_compared(capsys):
    assert guarded(COMPARISON) == 0
    output = capsys.readouterr().out
    for start in ("y_dot [m/s]", "p = ", "replay: the analysed controller's u_total"):
        expected = page_numbers(start)
        assert printed_numbers(output, start)[: len(expected)] == pytest.approx(expected, rel=TOLERANCE), start


@pytest.mark.usefixtures("climb")
def test_the_laws_of_the_climb(capsys):
    assert guarded([*COMPARISON, "--fit", "--out", "laws.toml"]) == 0
    output = capsys.readouterr().out
    for start in ("parameters.lag [SI]", "disturbance.value [m/s]", "warning: the residual of y is"):
        expected = page_numbers(start)
        assert printed_numbers(output, start)[: len(expected)] == pytest.approx(expected, rel=TOLERANCE), start
