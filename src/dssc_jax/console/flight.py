"""Print the cost of generated flight code, and comparisons of logged flights with the draws and fits of laws."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

from dssc_jax.console.terminal import show_files, show_line, show_table, values_text
from dssc_jax.flight_logs.comparison import NO_SPREAD, LogAnswer, LogComparison
from dssc_jax.flight_logs.fit.command_gaps import HELD
from dssc_jax.flight_logs.next_flight import NextFlight, NextFlightAnswer, StudyTest
from dssc_jax.flight_logs.signal_warnings import FlightWarning, SignalWarning
from dssc_jax.study import Study

SIGNIFICANCE = 0.05
"""Level of the test whether a log is a flight of the study."""
MOST_MINIMA = 3
"""Largest number of minima, beside the best, that are printed."""
LARGE_OUTSIDE_SHARE = 0.05
"""Share of samples outside the range of all draws above which the verdict names a signal."""


class Table(NamedTuple):
    """A table of text.

    Args:
        head: Names of the columns.
        rows: Cells of each row.
    """

    head: tuple[str, ...]
    rows: list[tuple[str, ...]]


def show_code(summary: dict[str, Any]) -> None:
    """Print the cost of each channel's step function, the verdict of Theorem 1, and the folder that was written.

    Args:
        summary: Summary of the folder: ``channels``, ``certificate``, ``folder``, and ``fmu`` if one was written.
    """
    rows = []
    for channel in summary["channels"]:
        operations = channel["operations"]
        slow_count = sum(operations.get(name, 0) for name in ("div", "sqrt", "rem"))
        counts = (sum(operations.values()), slow_count, channel["chain"])
        sizes = (channel["state_bytes"], channel["parameter_bytes"])
        rows.append((f"{channel['prefix']}_step", *map(str, (*counts, *sizes))))
    show_table(("function", "operations", "quotients, roots", "longest chain", "state [bytes]", "parameters"), rows)
    show_line(summary["certificate"])
    show_line(f"wrote {summary['folder']}; make -C {summary['folder']} checks every bit")
    fmu = summary.get("fmu")
    if fmu is not None:
        content = "with its library" if fmu["library"] else f"without a library, its sources only: {fmu['reason']}"
        show_line(f"wrote {summary['folder']}/{fmu['file']}, {content}")


def show_log_comparison(comparison: LogComparison, files: list[Path]) -> None:
    """Print where a log lies among the draws, the p-value, and how the replayed commands differ from the log.

    Args:
        comparison: The comparison.
        files: Files that were written, whose paths are printed.
    """
    answer = comparison.answer
    show_line(f"{comparison.study.name}: {answer.log} over {answer.draws} draws, {compared_samples_text(answer)}")
    if answer.p_value is None:
        show_line(NO_SPREAD)
    else:
        show_table(*departure_table(answer))
    if answer.without_spread:
        show_table(*constant_signal_table(answer))
    if answer.p_value is not None:
        show_rank(answer, answer.p_value)
    replays = {}
    for name, signal in answer.signals.items():
        if signal.replay is not None:
            replays[name] = asdict(signal.replay) | {"unit": signal.unit}
    show_replay(asdict(answer) | {"replay": replays}, comparison.study)
    show_warnings(answer.warnings)
    show_files(files)


def compared_samples_text(answer: LogAnswer) -> str:
    """Tell how many samples are compared, at how many of these the log has a value, and whether the log ends early.

    The log ends early if it has fewer samples than the study. A file that is cut off within a message is named, too.
    """
    is_shorter = answer.samples < answer.study_samples
    of_study = f" of the study's {answer.study_samples}" if is_shorter else ""
    compared = f"{answer.samples}{of_study} samples"
    if answer.logged_samples < answer.samples:
        compared = f"which has a value at {answer.logged_samples} of {compared}"
    ending = ": the log ends before the study" if is_shorter else ""
    cut = "; its file is cut off within a message" if answer.cut else ""
    return f"{compared}{ending}{cut}"


def show_replay(summary: Mapping[str, Any], study: Study) -> None:
    """Print how replayed commands and references differ from the logged ones.

    The commands are those of the analysed controller, and the references are those of the study.

    Args:
        summary: ``replay``, ``dropped_rows`` and ``held_samples`` by signal, ``replayed_samples``, ``not_replayed``,
            ``reference_differences`` and ``reference_rate_differences`` by channel.
        study: The study, whose channels have the references' units.
    """
    for name, replay in summary["replay"].items():
        show_line(
            f"replay: the analysed controller's {name} differs by at most {replay['largest_difference']:.4g} "
            f"{replay['unit']} (at {replay['largest_difference_at']:.4g} s), "
            f"rms {replay['rms_difference']:.4g} of {replay['rms_logged']:.4g}"
        )
    if summary["dropped_rows"]:
        counts = ", ".join(f"{count:,} of {name}" for name, count in summary["dropped_rows"].items())
        show_line(f"rows left out, because their times fall: {counts}")
    if summary["held_samples"]:
        show_line(held_text(summary["held_samples"], summary["replayed_samples"], "replay"))
    for channel, reason in summary["not_replayed"].items():
        place = f", {channel}" if channel else ""
        show_line(f"not replayed{place}: {reason}")
    differences = summary["reference_differences"]
    rates = summary["reference_rate_differences"]
    for channel, units in zip(study.loop.channels, study.units, strict=True):
        if channel not in differences:
            continue
        place = f" of {channel}" if channel else ""
        largest = f"{differences[channel]:.4g} {units.output}"
        text = f"the logged reference{place} differs from the study's by at most {largest}"
        if channel in rates:
            text += f", its rate by at most {rates[channel]:.4g} {units.of('y/s')}"
        show_line(text)


def show_warnings(warnings: Sequence[SignalWarning]) -> None:
    """Print warnings; if there are several logs, each with the name of its log."""
    for warning in warnings:
        log_name = f"{warning.log}: " if isinstance(warning, FlightWarning) else ""
        show_line(f"warning: {log_name}{warning.text}")


def held_text(held_counts: Mapping[str, int], samples: int, subject: str, between: str = HELD) -> str:
    """Tell how many samples of each signal a log has, and what is assumed between these samples.

    Args:
        held_counts: Number of samples that the log lacks, by signal; only signals that lack some.
        samples: Number of samples of a complete log.
        subject: Use of the samples, such as "replay".
        between: Assumption between the samples that the log has.
    """
    counts = ", ".join(f"{name} at {samples - count}" for name, count in held_counts.items())
    return f"{subject}: of {samples} samples, the log has {counts}; between them {between}"


def departure_table(answer: LogAnswer) -> Table:
    """Make the table of how far the logged signals depart from the draws.

    A signal that is equal in all draws is left out.
    """
    rows = []
    for name, signal in answer.signals.items():
        if signal.outside_share is None:
            continue
        row = (
            f"{name} [{signal.unit}]",
            number_or_dash(signal.largest_departure),
            f"{100 * signal.outside_share:.3g} %",
            number_or_dash(signal.first_outside),
            number_or_dash(signal.outside_to_the_end_since),
        )
        rows.append(row)
    head = ("signal", "largest departure", "outside the draws", "first at [s]", "to the end since [s]")
    return Table(head, rows)


def constant_signal_table(answer: LogAnswer) -> Table:
    """Make the table of the largest difference between the log and each signal that is equal in all draws."""
    rows = []
    for name, largest in answer.without_spread.items():
        rows.append((f"{name} [{answer.signals[name].unit}]", f"{largest:.4g}"))
    return Table(("the same in all draws, without a rank", "the log differs by at most"), rows)


def show_next_flight(outlook: NextFlight, files: list[Path]) -> None:
    """Print the limits of the next flight, and whether the flights refute the study.

    Args:
        outlook: The analysis.
        files: Files that were written, whose paths are printed.
    """
    answer = outlook.answer
    show_line(f"{outlook.study.name}: {answer.flights} flights over {answer.draws} draws, {answer.samples} samples")
    show_line(outlook.headline)
    show_table(*limit_table(answer))
    for name in answer.without_spread:
        show_line(f"{name} is the same in all draws, and is left out")
    show_line(beyond_text(answer))
    show_warnings(answer.warnings)
    show_table(*counts_table(answer.study_test))
    show_files(files)


def limit_table(answer: NextFlightAnswer) -> Table:
    """Make the table of the limits of each metric for the next flight, beside the flights so far and the draws."""
    rows = []
    for name, metric in answer.metrics.items():
        beyond = "" if metric.draws_beyond is None else f"{100 * metric.draws_beyond:.3g} %"
        limit = "too few flights" if metric.limit is None else f"{metric.limit:.4g}"
        row = (f"{name} [{metric.unit}]", limit, f"{metric.largest:.4g}", f"{metric.median_of_draws:.4g}", beyond)
        rows.append(row)
    head = (
        f"the next flight, {100 * answer.probability:g} %",
        "at most",
        "largest so far",
        "median of draws",
        "draws beyond",
    )
    return Table(head, rows)


def beyond_text(answer: NextFlightAnswer) -> str:
    """Tell how many flights depart farther than 95 % of the draws, with the interval of their share."""
    test = answer.study_test
    low, high = test.share_interval
    names = f" ({', '.join(test.logs_beyond)})" if test.logs_beyond else ""
    return (
        f"{test.beyond} of {answer.flights} flights{names} depart farther than 95 % of the draws "
        f"(p = {test.p_value:.3g}); that share lies in [{low:.3g}, {high:.3g}]"
    )


def counts_table(test: StudyTest) -> Table:
    """Make the table of the numbers of flights that would refute or confirm the study.

    Each row is for one true share of extreme flights.
    """
    rows = []
    for share, refuting_count in test.flights_to_refute.items():
        counts = (refuting_count, test.flights_to_confirm[share])
        texts = ["too many" if count is None else str(count) for count in counts]
        rows.append((f"{100 * float(share):g} %", *texts))
    head = ("share of flights beyond", "flights that refute the study", "flights that show less, if it is right")
    return Table(head, rows)


def show_rank(answer: LogAnswer, p_value: float) -> None:
    """Print the p-value of a log, and the verdict whether the log is a flight of the study.

    Args:
        answer: The comparison.
        p_value: The p-value, by the rank of the log among the draws.
    """
    show_line(
        f"p = {p_value:.4g}: {answer.draws_at_least_as_extreme} of {answer.draws} draws depart "
        f"as much; most in {answer.decisive_signal} at {answer.decisive_time:.4g} s"
    )
    lacks_samples = answer.logged_samples < answer.samples
    sample_text = f", by the {answer.logged_samples} samples that it has" if lacks_samples else ""
    if p_value > SIGNIFICANCE:
        verdict = f"at the {100 * SIGNIFICANCE:g} % level, nothing in the log contradicts the study{sample_text}"
        show_line(f"{verdict}{outside_text(answer)}")
    else:
        show_line(
            f"at the {100 * SIGNIFICANCE:g} % level, the log is not a flight of the study; `--fit` estimates its "
            "numbers from the log, and looks for what else the residual may be"
        )
    if answer.least_p_value > SIGNIFICANCE:
        show_line(f"p cannot be below {answer.least_p_value:.3g}: take more draws")


def outside_text(answer: LogAnswer) -> str:
    """Name the signals that are outside the range of all draws for many of their samples; empty if none is.

    "Many" is a share of the signal's samples above :data:`LARGE_OUTSIDE_SHARE`.
    """
    shares = []
    for name, signal in answer.signals.items():
        if signal.outside_share is not None and signal.outside_share > LARGE_OUTSIDE_SHARE:
            shares.append(f"{name} for {100 * signal.outside_share:.3g} % of its samples")
    return f", but it leaves the range of all draws: {', '.join(shares)}" if shares else ""


def show_fit(summary: Mapping[str, Any], warnings: Sequence[SignalWarning]) -> None:
    """Print the estimates with their intervals, the residual, warnings, and the proposed laws or the file with them.

    Args:
        summary: Summary of the fit and of the log's replay, as printed for JSON.
        warnings: Warnings about the log and the fit.
    """
    commands = "replayed commands, because the log lacks some" if summary["replayed"] else "logged commands"
    show_line(f"{summary['study']}: {summary['samples']} outputs, simulated for the {commands}")
    if summary["simulated_samples"] < summary["study_samples"]:
        show_line(
            f"the log ends at {summary['simulated_samples']} of the study's {summary['study_samples']} samples: "
            "it says nothing of what comes later"
        )
    if summary["held_commands"]:
        course = summary["between_commands"]
        show_line(held_text(summary["held_commands"], summary["simulated_samples"], "commands", course))
    show_estimates(summary["numbers"])
    for channel, noise in summary["noise"].items():
        label = f"residual of {channel}" if channel else "residual"
        show_line(residual_text(label, noise, summary["noise_unit"][channel]))
    for line in (*search_lines(summary), *untried_lines(summary["untried_parts"]), *kept_lines(summary["kept"])):
        show_line(line)
    show_warnings(warnings)
    if summary["file"]:
        show_line(f"wrote {summary['file']}")
    else:
        show_line("in place of the study's lines of the same names, section by section:")
        show_line("")
        show_line(summary["toml"].rstrip())


def show_estimates(numbers: Mapping[str, Any]) -> None:
    """Print each estimate with its 90 % interval and the law in the study."""
    rows = []
    for name, number in numbers.items():
        low, high = number["interval_90"]
        interval = f"{low:.6g} to {high:.6g}"
        rows.append((f"{name} [{number['unit']}]", f"{number['estimate']:.6g}", interval, number["prior"]))
    show_table(("number", "estimate", "90 % interval", "law in the study"), rows)


def search_lines(summary: Mapping[str, Any]) -> list[str]:
    """Describe the search for the best estimates, and other minima of the residual."""
    starts = f"{summary['starts_here']} of {summary['starts']} starts of the search end in this minimum"
    refined = ", with those that refine the best minimum" if summary["search_cut"] else ""
    lines = [f"{starts}; {summary['simulations']} simulations{refined}"]
    minima = summary["other_minima"]
    for minimum in minima[:MOST_MINIMA]:
        values = values_text(minimum["values"], ".4g")
        lines.append(f"{minimum['starts']} end where the residual is {minimum['ratio']:.3g} times as large: {values}")
    if len(minima) > MOST_MINIMA:
        lines.append(f"others end in {len(minima) - MOST_MINIMA} more minima, which --json lists")
    return lines


def untried_lines(reason: str) -> list[str]:
    """Name the parts that the study may lack and that were not tried.

    Args:
        reason: Why they were not tried; empty: they were tried, and the result has no line.
    """
    if not reason:
        return []
    return [
        f"not tried, because {reason}: parts that it may lack, such as drag, friction, a wind, a lag, limits or a gain "
        "that changes. Without a warning they may be there all the same"
    ]


def kept_lines(widths: Mapping[str, float | None]) -> list[str]:
    """Name the numbers that the flight does not identify; these keep their laws.

    Args:
        widths: Standard deviation that the flight leaves to each number, relative to that of the number's law, by name;
            None: the output does not depend on the number.
    """
    lines = []
    for name, width in widths.items():
        remark = "the output does not depend on it" if width is None else f"it leaves {width:.3g} standard deviations"
        lines.append(f"not told by this flight, keeps its law: {name}; {remark}")
    return lines


def residual_text(label: str, noise: Mapping[str, Any], unit: str) -> str:
    """Describe the size of a residual, and how it is correlated in time.

    Args:
        label: Name of the residual.
        noise: The residual's ``rms``, ``output_std``, ``correlated_share``, ``correlation_time`` and
            ``white_probability``.
        unit: Unit of the output.
    """
    text = f"{label}: {noise['rms']:.4g} {unit} rms of an output with a standard deviation of {noise['output_std']:.4g}"
    if noise["correlated_share"] == 0.0:
        return f"{text}, white with a probability of {100 * noise['white_probability']:.3g} %"
    share = 100 * noise["correlated_share"]
    return f"{text}, {share:.3g} % of its variance correlated over {noise['correlation_time']:.3g} s"


def number_or_dash(value: float | None) -> str:
    """Format a number with four digits; a dash for None."""
    return "-" if value is None else f"{value:.4g}"
