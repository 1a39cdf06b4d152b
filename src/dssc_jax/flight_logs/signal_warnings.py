"""The warnings of a comparison or a fit: what a user has to look at before the answer is trusted."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Literal, NamedTuple, TypeAlias

from dssc_jax.core.quantities import Quantity

WarningCode: TypeAlias = Literal[
    "actuator-start",
    "another-command",
    "another-reference",
    "another-unit",
    "changing-gain",
    "clock-rate",
    "command-dropouts",
    "command-jump",
    "command-offset",
    "command-spikes",
    "copied-column",
    "correlated-residual",
    "damaged-log",
    "delayed-command",
    "delayed-output",
    "early-end",
    "estimate-outside-law",
    "estimator-reset",
    "exchanged-columns",
    "faster-controller",
    "filtered-command",
    "filtered-output",
    "first-integrals",
    "held-command",
    "held-output",
    "initial-output",
    "initial-speed",
    "integral-drift",
    "integral-factor",
    "interpolated-command",
    "interpolated-output",
    "invalid-values",
    "large-residual",
    "level-start",
    "limited-command",
    "missing-dead-zone",
    "missing-force",
    "missing-lag",
    "missing-limit",
    "missing-rounding",
    "noisy-output",
    "outliers",
    "output-jump",
    "output-likeness",
    "rare-command",
    "reference-slope",
    "repeated-rows",
    "repeated-times",
    "rough-squares",
    "rounded-command",
    "rounded-output",
    "row-numbers",
    "shifted-command",
    "shifted-output",
    "shifted-reference",
    "slower-controller",
    "start-in-air",
    "start-motion",
    "still-rate",
    "stuck-command",
    "stuck-output",
    "wrong-scale",
]
"""What a warning is about, for scripts; docs/log_fits.md lists the codes beside the messages."""

EXPLANATIONS: tuple[WarningCode, ...] = (
    "delayed-command",
    "delayed-output",
    "filtered-output",
    "missing-dead-zone",
    "missing-force",
    "missing-lag",
    "missing-limit",
    "missing-rounding",
    "changing-gain",
    "rough-squares",
)
"""Warnings of what would explain a residual: a fault of the log that another warning names may do so, too."""
FAULTS: tuple[WarningCode, ...] = (
    "clock-rate",
    "command-dropouts",
    "command-jump",
    "command-spikes",
    "damaged-log",
    "faster-controller",
    "filtered-command",
    "held-command",
    "integral-drift",
    "integral-factor",
    "interpolated-command",
    "outliers",
    "output-jump",
    "rare-command",
    "repeated-rows",
    "repeated-times",
    "rounded-command",
    "rounded-output",
    "shifted-command",
    "stuck-command",
    "stuck-output",
    "wrong-scale",
)
"""Faults of the outputs, commands or times of a log, which a part that a study lacks may resemble."""
EFFECTS: tuple[WarningCode, ...] = (
    "initial-output",
    "command-offset",
    "another-reference",
    "another-command",
    "output-likeness",
    "noisy-output",
    "large-residual",
    "estimate-outside-law",
)
"""Warnings that tell an effect, which the cause in another warning of the same log usually explains; nearest first."""


OUTPUTS: tuple[WarningCode, ...] = (
    "filtered-output",
    "held-output",
    "initial-output",
    "integral-drift",
    "integral-factor",
    "interpolated-output",
    "outliers",
    "output-jump",
    "output-likeness",
    "rounded-output",
    "shifted-output",
    "stuck-output",
)
"""Warnings about an output that the flight's controller may have got otherwise, and then gave another command."""
OPEN_CAUSE = "The cause is open"
"""Words of the hint about a command that no cause explains."""


class Hint(NamedTuple):
    """What is wrong with a signal or a number, in words that follow its name."""

    code: WarningCode
    text: str


@dataclass(frozen=True)
class SignalWarning:
    """A reason to doubt what a log tells, with the signal that it concerns."""

    signal: Annotated[
        str, Quantity("", "signal of the log or number of the study that a warning concerns; empty: the answer as such")
    ]
    code: Annotated[WarningCode, Quantity("", "what it is about, for scripts")]
    text: Annotated[str, Quantity("", "what is wrong, what follows from it, and what to do")]


@dataclass(frozen=True)
class FlightWarning(SignalWarning):
    """A warning of one flight among several."""

    log: Annotated[str, Quantity("", "name of the log that it concerns")]


def possible_causes(warnings: Iterable[SignalWarning]) -> tuple[SignalWarning, ...]:
    """The warnings that may explain a residual: faults of a log, and limits of the command that the study lacks."""
    return tuple(warning for warning in warnings if warning.code in FAULTS or warning.code == "limited-command")


def signal_warnings(hints: Mapping[str, Hint]) -> tuple[SignalWarning, ...]:
    """Turn hints, by signal or number, into warnings whose texts begin with that name."""
    return tuple(SignalWarning(name, hint.code, f"{name} {hint.text}") for name, hint in hints.items())


def causes_first(warnings: Iterable[SignalWarning]) -> tuple[SignalWarning, ...]:
    """Order warnings: faults of the log, explanations of a residual, effects as in :data:`EFFECTS`; else as they are.

    A change of a command where the log lacks it comes after the other faults, since commands that are logged too rarely
    cause it.
    """

    def rank(warning: SignalWarning) -> int:
        """Place of a warning: 0 a fault of the log, 1 a command's change in a gap, 2 an explanation, from 3 effects."""
        if warning.code in EFFECTS:
            return EFFECTS.index(warning.code) + 3
        if warning.code in EXPLANATIONS:
            return 2
        return 1 if warning.code == "command-jump" else 0

    return tuple(sorted(warnings, key=rank))


def fault_text(warnings: Iterable[SignalWarning]) -> str:
    """A sentence that names a log's faults, which a delay or a part of a fit may only resemble; empty if it has none.

    Faults of references do not count, because a fit of logged commands does not use references.
    """
    faults = {}
    for warning in warnings:
        if warning.code in FAULTS and not warning.signal.endswith(("y_ref", "y_ref_dot")):
            place = f" of {warning.signal}" if warning.signal else ""
            faults[f"{warning.code}{place}"] = None
    if not faults:
        return ""
    return f". The log has another fault ({', '.join(faults)}), which this may only resemble: mend that first"


def hedged(warnings: Iterable[SignalWarning]) -> tuple[SignalWarning, ...]:
    """The warnings; if the log has a fault, those about delays and parts add that they may only resemble the fault."""
    all_warnings = list(warnings)
    text = fault_text(all_warnings)
    hedged_warnings = []
    for warning in all_warnings:
        is_explanation = warning.code in EXPLANATIONS and warning.code != "rough-squares"
        hedged_warnings.append(replace(warning, text=warning.text + text) if is_explanation else warning)
    return tuple(hedged_warnings)


def with_named_causes(warning: SignalWarning, fitted: Iterable[SignalWarning]) -> SignalWarning:
    """A warning of a replay; if it leaves the cause of a command open, the causes that a fit names are added.

    Args:
        warning: The warning of the replay.
        fitted: The warnings of the fit.
    """
    channel = warning.signal.removesuffix("u_total")
    codes = {cause.code: None for cause in fitted if cause.code in OUTPUTS and cause.signal == f"{channel}y"}
    if OPEN_CAUSE not in warning.text or not codes:
        return warning
    effect, _, _ = warning.text.partition(OPEN_CAUSE)
    return replace(warning, text=f"{effect}Another warning names what may cause it ({', '.join(codes)})")


def joined_warnings(of_replay: Iterable[SignalWarning], of_fit: Iterable[SignalWarning]) -> tuple[SignalWarning, ...]:
    """The warnings of a replay and a fit, causes first; if both have a signal and code in common, that of the fit.

    A fit warns of a constant in the command only if the vehicle did not answer it. So this warning comes first, as a
    cause and not as an effect.
    """
    fitted = tuple(of_fit)
    told = {(warning.signal, warning.code) for warning in fitted}
    remaining = []
    for warning in of_replay:
        if (warning.signal, warning.code) not in told:
            remaining.append(with_named_causes(warning, fitted))
    all_warnings = causes_first(hedged((*remaining, *fitted)))
    mended = [warning for warning in fitted if warning.code in ("actuator-start", "command-offset")]
    others = [warning for warning in all_warnings if warning not in mended]
    return (*mended, *others)
