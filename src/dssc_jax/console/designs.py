"""A design and its certificate as tables, for the terminal and for LaTeX."""

from typing import NamedTuple, get_type_hints

from rich.markup import escape

from dssc_jax.console.terminal import output, show_table
from dssc_jax.core.quantities import Quantity
from dssc_jax.design import Certificate, Constants, Parameters
from dssc_jax.design.feasibility import Limits
from dssc_jax.design.files import DesignFile, functions_toml

TableRow = tuple[str, ...]


class DesignTable(NamedTuple):
    """A titled table of text."""

    title: str
    head: TableRow
    rows: list[TableRow]


def figures(value: float | None) -> str:
    """Format a number; a dash if there is none."""
    return "-" if value is None or value != value else f"{value:.5g}"


def design_tables(design: DesignFile, certificate: Certificate) -> list[DesignTable]:
    """The tables of parameters, inequalities, small gain and guarantees."""
    return [
        DesignTable("Parameters", ("parameter", "value", "unit", "meaning"), parameter_rows(design.parameters)),
        inequality_table(certificate),
        small_gain_table(certificate),
        guarantee_table(design, certificate),
        DesignTable("Constants", ("constant", "value", "unit", "meaning"), parameter_rows(certificate.constants)),
    ]


def parameter_rows(numbers: Parameters | Constants) -> list[TableRow]:
    """Each number with its unit and meaning."""
    hints = get_type_hints(type(numbers), include_extras=True)
    rows = []
    for name, value in numbers._asdict().items():
        mark: Quantity = hints[name].__metadata__[0]
        rows.append((name, figures(value), mark.unit, mark.meaning))
    return rows


def inequality_table(certificate: Certificate) -> DesignTable:
    """The inequalities of Table 1 with slacks, as derived and as printed."""
    rows = []
    for i in certificate.inequalities:
        numbers = [figures(number) for number in (i.value, i.bound, i.slack, i.printed_slack)]
        rows.append((i.name, *numbers, i.state.value.replace("_", " "), i.equation))
    head = ("inequality", "value", "must exceed", "slack", "printed slack", "state", "equation")
    return DesignTable("Design inequalities, for all k_p", head, rows)


READINGS = {
    "derived": "linear comparison system of (58) and (60); certifies",
    "theorem": "4 gamma_1 gamma_2 <= phi_b^2 (Appendix G) with the derived gains",
    "printed": "last bound of Appendix D as printed",
}


def small_gain_table(certificate: Certificate) -> DesignTable:
    """The three readings of the small-gain condition."""
    phi_b = certificate.phi_b
    rows = []
    for name, bound in certificate.small_gain._asdict().items():
        rows.append((name, figures(phi_b), figures(bound), figures(phi_b - bound), READINGS[name]))
    return DesignTable("Small gain", ("reading", "phi_b", "must exceed", "slack", "source"), rows)


def guarantee_table(design: DesignFile, certificate: Certificate) -> DesignTable:
    """The guarantees: residuals, rate, proofs, and what a running loop needs."""
    g = certificate.guarantee
    proofs = certificate.lyapunov
    needs = certificate.practice
    rows = [
        ("ultimate bound of |e|", figures(g.e), "m"),
        ("ultimate bound of |sigma|", figures(g.sigma), "m/s"),
        ("constant of O(1/phi_b^2) of |e|", figures(g.order), "m"),
        ("decay rate to the residual set", figures(g.decay_rate), "1/s"),
        ("smallest eigenvalue of P", figures(proofs.p_smallest), "SI"),
        ("smallest eigenvalue of Q - 2 eps I found", figures(proofs.q_smallest), "SI"),
        ("Q - 2 eps I > 0 for all sigma, e, alpha, k_p", "proved" if proofs.q_proved else "not proved", ""),
        ("k_o tau_av > 0 and tau_m > 0 for all sigma, e", "proved" if proofs.functions_proved else "not proved", ""),
        ("sampling period, at sigma = e = 0", figures(needs.sample_time_origin), "s"),
        ("sampling period, over the residual set", figures(needs.sample_time), "s"),
        ("|u_av| over the residual set", figures(needs.u_av), "m/s"),
    ]
    if design.modulation is not None:
        rows += [
            ("constant rho that keeps sliding there", figures(design.modulation.needed_rho(needs)), "m/s"),
            ("time of the first sliding under (33)", figures(design.modulation.first_sliding), "s"),
        ]
    return DesignTable("Guaranteed", ("what", "value", "unit"), rows)


def limits_table(limits: Limits) -> DesignTable:
    """How far each bound can change with the others unchanged."""
    meanings = {
        "phi_b": "least phi_b",
        "disturbance": "largest factor on k_d1 ... k_d5, alpha_d2, alpha_d3",
        "k_min": "least k_min",
        "k_max": "largest k_max",
        "a_max": "largest a_max",
    }
    rows = [(meanings[name], figures(value)) for name, value in limits._asdict().items()]
    return DesignTable("Certified up to, one at a time", ("limit", "value"), rows)


def show(design: DesignFile, certificate: Certificate, limits: Limits | None) -> None:
    """Print a design."""
    printable_name = "".join(character if character.isprintable() else "?" for character in design.name)
    verdict = "[green]certified[/green]" if certificate.certified else "[red]not certified[/red]: "
    output().print(f"[bold]{escape(printable_name)}[/bold]: {verdict}{escape(reasons(certificate))}")
    if certificate.certified:
        output().print("In continuous time, without unmodelled dynamics, and with a rho that keeps sliding.")
    for table in [*design_tables(design, certificate), *([limits_table(limits)] if limits else [])]:
        show_table(table.head, table.rows, title=table.title)
    for edge in design.edges:
        output().print(f"{edge}; a wider range in [goal.vary] may do better", markup=False)
    if design.goal is not None or design.free is not None:
        output().print("In a study:", markup=False)
        output().print(functions_toml(design.parameters), markup=False, highlight=False)


def reasons(certificate: Certificate) -> str:
    """The reasons why there is no certificate."""
    failing = [f"{i.name} {i.state.value.replace('_', ' ')}" for i in certificate.inequalities if not i.satisfied]
    if not certificate.interconnected:
        bound = certificate.small_gain.derived
        failing.append(f"small gain needs phi_b > {figures(bound)}" if bound == bound else "small gain needs P > 0")
    return "; ".join(failing)


SPECIAL = {"\\": r"\textbackslash{}", "^": r"\^{}", "~": r"\~{}"}
SPECIAL |= {character: f"\\{character}" for character in "_%&#${}"}
SPECIAL |= {character: f"${character}$" for character in "<>|"}


def latex(design: DesignFile, certificate: Certificate) -> str:
    """The tables as LaTeX; they need the package booktabs."""
    parts = []
    for table in design_tables(design, certificate):
        body = "\n".join(" & ".join(map(escaped, row)) + r" \\" for row in table.rows)
        parts.append(
            f"\\begin{{table}}\n\\caption{{{escaped(f'{table.title} of {design.name}')}}}\n"
            f"\\begin{{tabular}}{{{'l' * len(table.head)}}}\n\\toprule\n{' & '.join(map(escaped, table.head))} \\\\\n"
            f"\\midrule\n{body}\n\\bottomrule\n\\end{{tabular}}\n\\end{{table}}"
        )
    return "\n\n".join(parts)


def escaped(text: str) -> str:
    """Escape LaTeX's special characters."""
    return "".join(SPECIAL.get(character, character) for character in text)
