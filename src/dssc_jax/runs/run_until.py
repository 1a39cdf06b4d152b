"""``run_until``: a run with a sequential stopping rule, which decides the number of draws."""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.json_types import JsonObject
from dssc_jax.core.signals import Outcome, ProgressCallback
from dssc_jax.engine.batching import Engine, Layout, computing, execute, join_batches, values_of_draws
from dssc_jax.engine.evaluation import require_independent
from dssc_jax.engine.sampling import Arrays
from dssc_jax.results.manifest import Manifest, read_manifest
from dssc_jax.results.result import Result
from dssc_jax.results.schema import copy_block, empty_dataset
from dssc_jax.runs.design_choice import DesignChoice, with_plain_draws
from dssc_jax.runs.run import integration_entry, run_manifest, stated_entry
from dssc_jax.statistics import Look, StoppingRule
from dssc_jax.statistics.sequential import FIRST
from dssc_jax.study import Study, takes_file

MOST_DRAWS = 100_000  # of a run, unless the caller states another number
BATCH = 1024  # draws that are computed at once
UNDECIDED = "undecided"


@takes_file
def run_until(
    study: Study,
    rule: StoppingRule,
    out: str | Path | None = None,
    *,
    most: int = MOST_DRAWS,
    progress: ProgressCallback | None = None,
    check: bool = True,
    within: Mapping[str, float] | None = None,
    shift: float | None = None,
    widening: float | None = None,
) -> Result:
    """Simulate draws until a stopping rule is satisfied at one of a geometric sequence of looks.

    The manifest of the result records the stopping rule, and the intervals remain valid under this rule. Draw i is the
    same as in any other run of the study.

    Args:
        study: The study, or its file, without a sweep; its number of draws is ignored.
        rule: The stopping rule.
        out: Results folder, written at the end; None: the result stays in memory.
        most: Maximum number of draws, after which the run stops undecided.
        progress: Called with the draws done and ``most``.
        check: As in :func:`dssc_jax.runs.run.run`.
        within: As in :func:`dssc_jax.runs.run.run`.
        shift: As in :func:`dssc_jax.runs.run.run` [standard deviations].
        widening: As in :func:`dssc_jax.runs.run.run`.

    Raises:
        ConfigError: The study is swept or its draws are not independent, ``most`` is out of range, or ``out``
            contains something else.
    """
    require_sequential(study)
    study, entries = with_independent_draws(study)
    amounts_entry = stated_entry(study, within, shift, widening)
    if most < FIRST:
        raise ConfigError(study.source, f"a data-driven stop needs at least {FIRST} draws, its first look, got {most}")
    longest = study.override({"draws": most})
    if out is not None:
        require_same_rule(Path(out), longest, rule, most)
    began = time.perf_counter()
    engine = Engine(longest, min(most, BATCH))
    stop = simulate_until_stop(engine, rule, most, progress)
    draws = stop.draws
    if progress:
        progress(draws, most)
    final = study.override({"draws": draws})
    dataset = empty_dataset(final)
    columns = {name: column[:draws] for name, column in join_batches(stop.batches).items()}
    copy_block(dataset, (slice(0, draws),), columns, values_of_draws(final, slice(0, draws)))
    manifest = run_manifest(final, Layout.of(final), computing()) | {
        "complete": True,
        "times": engine.times(began),
        **integration_entry(final, check),
        **amounts_entry,
        **entries,
        "stopping": stopping_entry(rule, stop, most),
    }
    result = Result.of(final, dataset, manifest)
    if out is not None:
        result.save(out)
    return result


class Stop(NamedTuple):
    """The end of a simulation under a stopping rule.

    Args:
        looks: The looks at which the failures were counted; the last one ended the simulation.
        failures: Number of failures among the first draws of each look.
        batches: Results of the draws, batch by batch; there may be more draws than at the last look.
        verdict: The rule's verdict at the last look; None: undecided.
    """

    looks: list[Look]
    failures: list[int]
    batches: list[Arrays]
    verdict: str | None

    @property
    def draws(self) -> int:
        """Number of draws at the last look, which is the number of draws of the result."""
        return self.looks[-1].draws


def simulate_until_stop(engine: Engine, rule: StoppingRule, most: int, progress: ProgressCallback | None) -> Stop:
    """Simulate batches of draws until the stopping rule has a verdict at one of its looks.

    Args:
        engine: The compiled study.
        rule: The stopping rule.
        most: Maximum number of draws.
        progress: Called with the draws done and ``most``; None: no callback.
    """
    starts = range(0, most, engine.lanes)
    blocks = [(slice(start, min(start + engine.lanes, most)),) for start in starts]  # of draws, without swept numbers
    running_batches = execute(engine, blocks)
    batches: list[Arrays] = []
    has_failed = np.empty(0, dtype=bool)  # of each draw so far
    looks: list[Look] = []
    failures: list[int] = []
    verdict = None
    for look in rule.looks(most):
        while len(has_failed) < look.draws:
            _, results, _ = next(running_batches)
            batches.append(results)
            has_failed = np.concatenate([has_failed, results["outcome"] != Outcome.OK])
            if progress:
                progress(len(has_failed), most)
        looks.append(look)
        failures.append(int(np.count_nonzero(has_failed[: look.draws])))
        verdict = rule.verdict(look, failures[-1])
        if verdict:
            break
    return Stop(looks, failures, batches, verdict)


def stopping_entry(rule: StoppingRule, stop: Stop, most: int) -> JsonObject:
    """The manifest's entry about the stopping rule, from which the intervals of the result follow.

    Args:
        rule: The stopping rule.
        stop: The end of the simulation.
        most: Maximum number of draws.
    """
    looks = []
    for look, failures in zip(stop.looks, stop.failures, strict=True):
        looks.append(look._asdict() | {"failures": failures})
    return {
        "data_driven": True,
        "rule": rule.text,
        "most": most,
        "verdict": stop.verdict or UNDECIDED,
        "looks": looks,
        "stops": rule.stops(most),
    }


def with_independent_draws(study: Study) -> tuple[Study, Manifest]:
    """Take plain draws for a study with ``sampling = "auto"``, since a stopping rule needs independent draws.

    Returns:
        The study, and the manifest's entry about the choice. Any other study is returned as it is, with an empty entry.
    """
    if study.config.sampling != "auto":
        return study, {}
    reason = "plain draws: the law of a data-driven stop is known for independent draws only"
    request = study.hash, study.config.draws
    choice = DesignChoice(with_plain_draws(study), reason, pilot=0, request=request)
    return choice.study, choice.entry


def require_sequential(study: Study) -> None:
    """Require that a study may run under a stopping rule: it has no sweep, and its draws are independent.

    Raises:
        ConfigError: The study has a sweep, or its draws are points of a Sobol or Latin-hypercube design.
    """
    if study.axes:
        raise ConfigError(study.source, "a data-driven stop is for one point; leave [sweep] aside")
    require_independent(study, "a data-driven stop")


def require_same_rule(folder: Path, study: Study, rule: StoppingRule, most: int) -> None:
    """Require that a results folder is empty, or contains a result of the same study and stopping rule.

    Args:
        folder: The folder.
        study: The study with ``most`` draws.
        rule: The stopping rule.
        most: Maximum number of draws.

    Raises:
        ConfigError: The folder contains something else.
    """
    is_empty = folder.is_dir() and not any(folder.iterdir())
    if not folder.exists() or is_empty:
        return
    no_result: Manifest = {"study": {}}
    manifest = read_manifest(folder) if folder.is_dir() else no_result
    stopping = manifest.get("stopping") or {}
    has_same_rule = stopping.get("rule") == rule.text and stopping.get("most") == most
    stored_study = manifest["study"] | {"draws": most}  # in place of the number at which the run stopped
    if not has_same_rule or stored_study != study.table:
        raise ConfigError(
            str(folder),
            "is no result of this study under this stopping rule; choose another `out`",
        )
