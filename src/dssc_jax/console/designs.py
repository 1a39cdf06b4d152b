"""Print a design and its certificate as tables, or write them as LaTeX."""

import math
from typing import NamedTuple, get_type_hints

from rich.markup import escape

from dssc_jax.console.terminal import output, show_paragraph, show_table
from dssc_jax.core.quantities import Quantity
from dssc_jax.design import Certificate, Constants, Parameters
from dssc_jax.design.feasibility import Limits
from dssc_jax.design.files import DesignFile, functions_toml

TableRow = tuple[str, ...]


class DesignTable(NamedTuple):
    """A table of text with a title.

    Args:
        title: The title.
        head: Names of the columns.
        rows: Cells of each row.
    """

    title: str
    head: TableRow
    rows: list[TableRow]


def digits(value: float | None) -> str:
    """Format a number with five digits; a dash if it is None or NaN."""
    return "-" if value is None or math.isnan(value) else f"{value:.5g}"


def design_tables(design: DesignFile, certificate: Certificate) -> list[DesignTable]:
    """Make the tables of a design: parameters, inequalities, small gain, guarantees and constants."""
    return [
        DesignTable("Parameters", ("parameter", "value", "unit", "meaning"), parameter_rows(design.parameters)),
        inequality_table(certificate),
        small_gain_table(certificate),
        guarantee_table(design, certificate),
        DesignTable("Constants", ("constant", "value", "unit", "meaning"), parameter_rows(certificate.constants)),
    ]


def parameter_rows(numbers: Parameters | Constants) -> list[TableRow]:
    """One row for each number: name, value, unit and meaning."""
    hints = get_type_hints(type(numbers), include_extras=True)
    rows = []
    for name, value in numbers._asdict().items():
        quantity: Quantity = hints[name].__metadata__[0]
        rows.append((name, digits(value), quantity.unit, quantity.meaning))
    return rows


def inequality_table(certificate: Certificate) -> DesignTable:
    """Table of the inequalities of Table 1, with their slacks as derived here and as printed in the article."""
    rows = []
    for inequality in certificate.inequalities:
        numbers = (inequality.value, inequality.bound, inequality.slack, inequality.printed_slack)
        state = inequality.state.value.replace("_", " ")
        rows.append((inequality.name, *map(digits, numbers), state, inequality.equation))
    head = ("inequality", "value", "must exceed", "slack", "printed slack", "state", "equation")
    return DesignTable("Design inequalities, for all k_p", head, rows)


SMALL_GAIN_SOURCES = {
    "derived": "linear comparison system of (58) and (60); certifies",
    "theorem": "4 gamma_1 gamma_2 <= phi_b^2 (Appendix G) with the derived gains",
    "printed": "last bound of Appendix D as printed",
}
"""Source of each form of the small-gain condition."""


def small_gain_table(certificate: Certificate) -> DesignTable:
    """Table of the three forms of the small-gain condition: derived here, of the theorem, and as printed."""
    phi_b = certificate.phi_b
    rows = []
    for name, bound in certificate.small_gain._asdict().items():
        rows.append((name, digits(phi_b), digits(bound), digits(phi_b - bound), SMALL_GAIN_SOURCES[name]))
    return DesignTable("Small gain", ("reading", "phi_b", "must exceed", "slack", "source"), rows)


def guarantee_table(design: DesignFile, certificate: Certificate) -> DesignTable:
    """Table of the guarantees: residuals, decay rate, Lyapunov conditions, and what the sampled loop needs."""
    guarantee = certificate.guarantee
    proofs = certificate.lyapunov
    practice = certificate.practice
    rows = [
        ("ultimate bound of |e|", digits(guarantee.e), "m"),
        ("ultimate bound of |sigma|", digits(guarantee.sigma), "m/s"),
        ("constant of O(1/phi_b^2) of |e|", digits(guarantee.order), "m"),
        ("decay rate to the residual set", digits(guarantee.decay_rate), "1/s"),
        ("smallest eigenvalue of P", digits(proofs.p_smallest), "SI"),
        ("smallest eigenvalue of Q - 2 eps I found", digits(proofs.q_smallest), "SI"),
        ("Q - 2 eps I > 0 for all sigma, e, alpha, k_p", "proved" if proofs.q_proved else "not proved", ""),
        ("k_o tau_av > 0 and tau_m > 0 for all sigma, e", "proved" if proofs.functions_proved else "not proved", ""),
        ("sampling period, at sigma = e = 0", digits(practice.sample_time_origin), "s"),
        ("sampling period, over the residual set", digits(practice.sample_time), "s"),
        ("|u_av| over the residual set", digits(practice.u_av), "m/s"),
    ]
    if design.modulation is not None:
        rows += [
            ("constant rho that keeps sliding there", digits(design.modulation.needed_rho(practice)), "m/s"),
            ("time of the first sliding under (33)", digits(design.modulation.first_sliding), "s"),
        ]
    return DesignTable("Guaranteed", ("what", "value", "unit"), rows)


def limits_table(limits: Limits) -> DesignTable:
    """Table of how far each bound of the design alone can change before the certificate is lost."""
    meanings = {
        "phi_b": "least phi_b",
        "disturbance": "largest factor on k_d1 ... k_d5, alpha_d2, alpha_d3",
        "k_min": "least k_min",
        "k_max": "largest k_max",
        "a_max": "largest a_max",
    }
    rows = [(meanings[name], digits(value)) for name, value in limits._asdict().items()]
    return DesignTable("Certified up to, one at a time", ("limit", "value"), rows)


def show_design(design: DesignFile, certificate: Certificate, limits: Limits | None) -> None:
    """Print a design with its certificate.

    Args:
        design: The design.
        certificate: Verdict of Theorem 1 on the design.
        limits: How far each bound of the plant can change alone before the certificate is lost; None if the design is
            not certified.
    """
    printable_name = "".join(character if character.isprintable() else "?" for character in design.name)
    verdict = "[green]certified[/green]" if certificate.certified else "[red]not certified[/red]: "
    output().print(f"[bold]{escape(printable_name)}[/bold]: {verdict}{escape(unmet_conditions(certificate))}")
    if certificate.certified:
        show_paragraph("In continuous time, without unmodelled dynamics, and with a rho that keeps sliding.")
    tables = design_tables(design, certificate)
    if limits:
        tables.append(limits_table(limits))
    for table in tables:
        show_table(table.head, table.rows, title=table.title)
    for edge in design.edges:
        show_paragraph(f"{edge}; a wider range in [goal.vary] may do better")
    if design.goal is not None or design.free is not None:
        show_paragraph("In a study:")
        show_paragraph(functions_toml(design.parameters))


def unmet_conditions(certificate: Certificate) -> str:
    """List the conditions that a design does not meet: inequalities, and the small-gain condition.

    The text is empty if the design meets all conditions.
    """
    conditions = []
    for inequality in certificate.inequalities:
        if not inequality.satisfied:
            conditions.append(f"{inequality.name} {inequality.state.value.replace('_', ' ')}")
    if not certificate.interconnected:
        bound = certificate.small_gain.derived
        if math.isnan(bound):  # P is not positive definite
            conditions.append("small gain needs P > 0")
        else:
            conditions.append(f"small gain needs phi_b > {digits(bound)}")
    return "; ".join(conditions)


LATEX_CHARACTERS = {"\\": r"\textbackslash{}", "^": r"\^{}", "~": r"\~{}"}
LATEX_CHARACTERS |= {character: f"\\{character}" for character in "_%&#${}"}
LATEX_CHARACTERS |= {character: f"${character}$" for character in "<>|"}
"""LaTeX of the characters that LaTeX would not print as they are."""


def latex(design: DesignFile, certificate: Certificate) -> str:
    """Write the tables of a design as LaTeX, which needs the package booktabs."""
    return "\n\n".join(latex_table(table, design.name) for table in design_tables(design, certificate))


def latex_table(table: DesignTable, design_name: str) -> str:
    """Write a table as LaTeX.

    Args:
        table: The table.
        design_name: Name of the design, for the caption.
    """
    lines = [
        r"\begin{table}",
        rf"\caption{{{latex_text(f'{table.title} of {design_name}')}}}",
        rf"\begin{{tabular}}{{{'l' * len(table.head)}}}",
        r"\toprule",
        latex_row(table.head),
        r"\midrule",
        *map(latex_row, table.rows),
        r"\bottomrule",
        r"\end{tabular}",
        r"\end{table}",
    ]
    return "\n".join(lines)


def latex_row(cells: TableRow) -> str:
    """Write a row of a LaTeX table."""
    return " & ".join(map(latex_text, cells)) + r" \\"


def latex_text(text: str) -> str:
    """Escape the characters of a text that are special in LaTeX."""
    return "".join(LATEX_CHARACTERS.get(character, character) for character in text)
