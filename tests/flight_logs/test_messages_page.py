"""The table of messages of docs/log_fits.md: a row for every message, and no row for one that is gone."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

from dssc_jax.flight_logs.signal_warnings import WarningCode

ROOT = Path(__file__).parents[2]
LOGS = ROOT / "src" / "dssc_jax" / "flight_logs"
PAGE = ROOT / "docs" / "log_fits.md"
LEAST_LENGTH = 40  # characters of a message; shorter texts are parts of one
PARTS = (
    "with that, the study describes the flight",  # behind the words for what is wrong
    "with that, the analysed controller gives",
    "with the study's reference the analysed controller gives",
    "Compare the log's columns",  # remedies, at the end of a message
    "give the study what acts on the flight",
    "Begin at the take-off",
    "The vehicle was not yet in the equilibrium",
    "= [0.0, 0.0, { normal",
    "Log the time",
    "its column may be another signal's. If the reference is a record",
    "shift the study's reference, or let its record begin",
    "Compare the log's times with those of another clock",
    "If it is the clock, scale the times",
    "the part after with a start",
    "give a number a wider law",
    "at least half as large from",  # what is known besides, within or after a message
    "it follows straight lines",
    "it is another topic's, such as a filtered",
    "the controller gets; a fit of logged commands",
    "the jump is taken out",
    "the flight followed a wrong velocity",
    "the log does not state the jump",
    "Another course describes it",
    "Log every command, or set loop.sample_time",
    "it lies within, as if",
    "these are the best numbers so far",
    "steps in the sum of squares",
    "fly longer, or steps",
    "fly gently enough",
    "commands between the logged ones",
    "jumps at moments that the log lacks",
    "the vehicle has been airborne",
    "one of both has the opposite sign",
    "is the study's with times x",
    "allow_damaged` fits it all the same",
    "What it leaves open comes from",
    "newtons in place of kilograms-force",
    "each in standard deviations of its law",
    "explains it nearly as well",
    "rms remain, where noise explains",
    "Its integral goes on at a limit",
    "That is still more than noise explains",
    "Estimates are wrong by more than",
    "Give the plant that force",
    "Give the study that force",
    "Give the study that {} with a law",
    "Give the study that lag with a law",
    "The logged y lies as much behind",
    "Log the command times the gain",
    "Fit the part that ends before",
)
PASSED_ON = ("output-likeness", "clock-rate", "row-numbers", "repeated-times")  # other modules word the message


def texts(path: Path) -> Iterator[str]:
    """The texts of a module with ``{}`` for what is filled in; no docstrings."""
    tree = ast.parse(path.read_text())
    skipped = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr):
            skipped.add(node.value)
        if isinstance(node, ast.JoinedStr):
            skipped |= set(node.values)
    for node in ast.walk(tree):
        if node in skipped:
            continue
        if isinstance(node, ast.JoinedStr):
            yield "".join(part.value if isinstance(part, ast.Constant) else "{}" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def rows() -> list[tuple[list[str], str]]:
    """The parts of messages, and the result, of each row of the page's tables of messages."""
    section = PAGE.read_text().partition("\n## Messages")[2].partition("\n## ")[0]
    columns = [line.split(" | ") for line in section.splitlines() if line.startswith("| `")]
    return [(re.findall(r"`([^`]+)`", first), result) for first, result, *_ in columns]


def fragments() -> list[str]:
    """The parts of messages in the first column of the page's tables of messages."""
    return [fragment for parts, _ in rows() for fragment in parts]


def messages() -> list[str]:
    """What hints, fits and replays may say."""
    files = [
        *(LOGS / "hints").glob("*.py"),
        *(LOGS / "fit").glob("*.py"),
        LOGS / "replay.py",
        LOGS / "channel_replay.py",
    ]
    return [text for file in files for text in texts(file) if len(text) >= LEAST_LENGTH and " " in text]


def test_every_message_has_a_row():
    known = (*fragments(), *PARTS)
    assert [text for text in messages() if not any(fragment in text for fragment in known)] == []
    assert len(messages()) > 60


def test_every_row_is_that_of_a_message():
    said = [text for file in LOGS.rglob("*.py") for text in texts(file)]
    assert [fragment for fragment in fragments() if not any(fragment in text for text in said)] == []
    assert [part for part in PARTS if not any(part in text for text in said)] == []
    assert len(fragments()) > 60


def test_every_warning_has_its_code_beside_its_message():
    """A module that gives a warning its code has a part of the message, or that of a hint which it passes on."""
    parts_by_code: dict[str, list[str]] = {}
    for parts, result in rows():
        codes = re.findall(r"`([a-z-]+)`", result)
        assert len(codes) == ("warning" in result), result
        for code in codes:
            parts_by_code.setdefault(code, []).extend(parts)
    assert sorted(parts_by_code) == sorted(get_args(WarningCode))
    said = {file: list(texts(file)) for file in LOGS.rglob("*.py") if file.name != "signal_warnings.py"}
    for code, parts in parts_by_code.items():
        files = [file for file, words in said.items() if code in words]
        assert files, code
        assert any(part in text for file in files for text in said[file] for part in parts) or code in PASSED_ON, code


def test_a_message_without_a_row_is_found():
    planted = "y is wrong in a way that no row of the table describes yet"
    assert not any(fragment in planted for fragment in (*fragments(), *PARTS))
