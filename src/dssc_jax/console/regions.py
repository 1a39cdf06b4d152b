"""Print the region of two numbers in which enough plants meet the requirements."""

from pathlib import Path

from dssc_jax.analyses.region.safe_region import RegionAnswer, SafeRegion
from dssc_jax.console.terminal import show_files, show_line, show_paragraph, show_required, show_table
from dssc_jax.results.schema import name_with_unit


def show_region(region: SafeRegion, files: list[Path]) -> None:
    """Print how many pairs of values are safe, the safe ranges, the confidence, and what Theorem 1 certifies.

    Args:
        region: The region.
        files: Files that were written, whose paths are printed.
    """
    answer = region.answer
    show_required(region.study.name, answer.requirements)
    share = f"{100 * answer.passing:g} %"
    rows = [
        (f"at least {share} of all plants pass", str(answer.meets), f"at most {answer.failures_allowed} failures"),
        ("undecided", str(answer.undecided), ""),
        (f"fewer than {share} pass", str(answer.fails), f"at least {answer.failures_refuting} failures"),
    ]
    lattice = " x ".join(map(str, answer.lattice))
    head = (" and ".join(answer.names), "pairs", f"of {answer.draws} draws")
    show_table(head, rows, f"{answer.simulated_points} of {lattice} pairs simulated")
    show_safe_ranges(answer)
    show_paragraph(f"{100 * answer.confidence:g} % confidence for all pairs together; nothing is claimed between them")
    show_line(f"{answer.certificate}; it certifies {answer.certified} pairs")
    show_files(files)


def show_safe_ranges(answer: RegionAnswer) -> None:
    """Print the safe ranges of the second number at some values of the first number."""
    first, second = [name_with_unit(name, unit) for name, unit in zip(answer.names, answer.units, strict=True)]
    rows = []
    for line in answer.safe_ranges:
        ranges = "; ".join(f"{low:.4g} to {high:.4g}" for low, high in line.second)
        rows.append((f"{line.first:.4g}", ranges))
    if rows:
        show_table((first, f"safe {second}"), rows, f"pairs at which at least {100 * answer.passing:g} % pass")
