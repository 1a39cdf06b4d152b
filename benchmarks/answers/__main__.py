"""Regenerates the table of docs/which_method.md: ``make answers``, some fifteen minutes on a quiet machine.

``python -m benchmarks.answers PEERS`` takes the Python of the environment with the other tools. Each answer is given by
a process of its own, twice; the first time counts as cold, the second as warm. An answer that takes longer than
``LIMIT`` is stopped. Finished answers are kept in results/answers.json, and not computed again unless that is deleted.
"""

import json
import subprocess
import sys
from pathlib import Path

from benchmarks.answers.studies import COMMON, RARE, RARER
from benchmarks.page import put
from dssc_jax.core.json_types import JsonObject

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "which_method.md"
KEPT = ROOT / "results" / "answers.json"
LIMIT = 400  # s
OURS = "ours"
NONE = "\N{EN DASH}"  # no method

SUBSET = {"OpenTURNS, subset": "OpenTURNS subset", "UQpy": "UQpy subset"}
IMPORTANCE = {OURS: "rare", "OpenTURNS": "OpenTURNS importance", "splitting": "splitting"}
INDICES = {OURS: "Sobol", "OpenTURNS": "OpenTURNS Sobol", "SALib": "SALib Sobol"}
WIDE = {OURS: "probability 1 %", "OpenTURNS": "OpenTURNS plain"}
NARROW = {OURS: "probability 0.1 %", "OpenTURNS": "OpenTURNS plain 0.1 %"}

ROWS: dict[tuple[str, str, str], dict[str, str]] = {
    ("a probability to ±1 %", "axis", COMMON): {**WIDE, "Monaco": "Monaco plain"},
    ("a probability to ±1 %", "gust", COMMON): WIDE,
    ("a probability to ±1 %", "turbulence", COMMON): WIDE,
    ("1e-5 to a factor of 1.3", "axis", RARE): IMPORTANCE | SUBSET,
    ("1e-5 to a factor of 1.3", "gust", RARE): IMPORTANCE | SUBSET,
    ("1e-6 to a factor of 1.3", "axis", RARER): IMPORTANCE,
    ("1e-6 to a factor of 1.3", "gust", RARER): IMPORTANCE,
    ("a 95/95 margin in mu", "axis", COMMON): {OURS: "margin"},
    ("a 95/95 margin in wind", "gust", RARE): {OURS: "margin"},
    ("a 95/95 margin in wind", "turbulence", COMMON): {OURS: "margin"},
    ("the ten best of 1,024 gains to ±2 %", "axis", COMMON): {OURS: "best gains"},
    ("the ten best of 1,024 gains to ±2 %", "gust", COMMON): {OURS: "best gains"},
    ("the ten best of 1,024 gains to ±2 %", "turbulence", COMMON): {OURS: "best gains"},
    ("a safe region of two numbers", "axis", COMMON): {OURS: "region"},
    ("a safe region of two numbers", "gust", COMMON): {OURS: "region"},
    ("a safe region of two numbers", "turbulence", COMMON): {OURS: "region"},
    ("a probability to ±0.1 %", "axis", COMMON): NARROW,
    ("a probability to ±0.1 %", "gust", COMMON): {OURS: NARROW[OURS]},
    ("a probability to ±0.1 %", "turbulence", COMMON): {OURS: NARROW[OURS]},
    ("Sobol indices to ±0.05", "axis", COMMON): INDICES,
    ("Sobol indices to ±0.05", "gust", COMMON): INDICES,
    ("Sobol indices to ±0.05", "turbulence", COMMON): {OURS: INDICES[OURS]},
}
"""The task of each tool that has a method, by question, model and bound."""

LAST = ("splitting", "UQpy subset", "OpenTURNS subset", "OpenTURNS plain 0.1 %")
"""Tasks that take minutes, and come last."""

PEERS = ("OpenTURNS", "UQpy", "SALib", "Monaco")


def answers(command: list[str]) -> list[JsonObject]:
    """The answers of a process, as far as it came within the limit.

    Raises:
        RuntimeError: The process failed; that is no slow answer.
    """
    try:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=LIMIT)
        printed = done.stdout
        if done.returncode:
            raise RuntimeError(f"{' '.join(command)} failed: {done.stderr}")
    except subprocess.TimeoutExpired as stopped:
        printed = stopped.stdout.decode() if isinstance(stopped.stdout, bytes) else stopped.stdout or ""
    return [json.loads(line) for line in printed.splitlines() if line.startswith("{")]


def measured(peers: str) -> dict[str, list[JsonObject]]:
    """All answers by model, bound and task; those that are kept are not asked again."""
    kept = json.loads(KEPT.read_text()) if KEPT.exists() else {}
    asked = [(model, bound, tool, task) for (_, model, bound), tasks in ROWS.items() for tool, task in tasks.items()]
    for model, bound, tool, task in sorted(asked, key=lambda ask: ask[-1] in LAST):
        key = f"{model}, {bound}, {task}"
        if key in kept:
            continue
        if tool in (OURS, "splitting"):
            command = [sys.executable, "-m", "benchmarks.answers.ours", model, bound, task]
        else:
            command = [peers, "benchmarks/answers/peers.py", sys.executable, model, bound, task]
        kept[key] = answers(command)
        print(key, kept[key], flush=True)
        KEPT.parent.mkdir(exist_ok=True)
        KEPT.write_text(json.dumps(kept, indent=1))
    return kept


def cell(found: list[JsonObject] | None) -> str:
    """Evaluations and seconds of an answer, cold and warm."""
    if found is None:
        return "not run"
    if not found:
        return f"none in {LIMIT} s"
    answered = [answer for answer in found if answer["answer"] is not None and answer["evaluations"]]
    if not answered:
        return "no answer"
    counts = sum(answer["evaluations"] for answer in answered) / len(answered)
    seconds = " / ".join(f"{answer['seconds']:.0f}" for answer in found)
    return f"{counts:,.0f} ({seconds} s)"


def plain_cell(ours: list[JsonObject], splitting: list[JsonObject] | None) -> str:
    """Evaluations of plain Monte Carlo for the same answer, and for a rare failure those of splitting."""
    counts = [answer["plain"] for answer in ours if answer["plain"]]
    text = f"{sum(counts) / len(counts):,.0f}" if counts else NONE
    return f"{text}; splitting {cell(splitting)}" if splitting is not None else text


def table(kept: dict[str, list[JsonObject]]) -> list[str]:
    """The rows of the table."""
    lines = [f"| question | model | here | plain Monte Carlo | {' | '.join(PEERS)} |", "|---" * (4 + len(PEERS)) + "|"]
    for (question, model, bound), tasks in ROWS.items():
        found = {tool: kept.get(f"{model}, {bound}, {task}") for tool, task in tasks.items()}
        cells = []
        for peer in PEERS:
            texts = [cell(answer) for tool, answer in found.items() if tool.startswith(peer)]
            cells.append("; subset sampling ".join(texts) or NONE)
        plain = plain_cell(found[OURS] or [], found.get("splitting"))
        lines.append(f"| {question} | {model} | {cell(found[OURS])} | {plain} | {' | '.join(cells)} |")
    return lines


def main(peers: str) -> int:
    lines = table(measured(peers))
    print("\n".join(lines))
    put("answers", "\n".join(lines), PAGE)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
