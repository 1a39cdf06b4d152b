"""``modelDescription.xml`` of the controllers as an FMU for co-simulation, FMI 2.0."""

import math
import re
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from xml.sax.saxutils import escape

from dssc_jax.core.units import parse_unit
from dssc_jax.flight_code.controller import FlightCode
from dssc_jax.flight_code.fmu_variables import INPUT, OUTPUT, PARAMETER, FmuVariable, flag_variables, real_variables
from dssc_jax.flight_code.header import not_generated
from dssc_jax.flight_code.template_files import fill

BASE_UNITS: tuple[str, ...] = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
"""Base units of FMI."""

DERIVED_UNITS = {
    "N": {"kg": 1, "m": 1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "C": {"A": 1, "s": 1},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "Hz": {"s": -1},
    "1": {},
}
"""Other SI units by base units (SI Brochure, 9th edition, table 4)."""

ROLES = {
    PARAMETER: {"causality": "parameter", "variability": "tunable", "initial": "exact"},
    INPUT: {"causality": "input", "variability": "discrete"},
    OUTPUT: {"causality": "output", "variability": "discrete", "initial": "calculated"},
}
STRUCTURED_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(\.[A-Za-z_][A-Za-z0-9_]*)*")
NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML 1.0 cannot express at all."""


def xml_text(text: str) -> str:
    """The text without what XML cannot express, on one line."""
    return " ".join(NO_XML.sub("\ufffd", text).split())


def base_exponents(unit: str) -> dict[str, int] | None:
    """Exponents of FMI's base units; None for a unit that is no product of whole powers of SI units."""
    try:
        powers = parse_unit(unit)
    except ValueError:
        return None
    exponents = dict.fromkeys(BASE_UNITS, 0)
    for symbol, power in powers.items():
        factors = {symbol: 1} if symbol in BASE_UNITS else DERIVED_UNITS.get(symbol)
        if factors is None or power.denominator != 1:
            return None
        for base, exponent in factors.items():
            exponents[base] += exponent * int(power)
    return {base: exponent for base, exponent in exponents.items() if exponent}


def description_text(code: FlightCode, guid: str, sources: Sequence[str]) -> str:
    """The text of ``modelDescription.xml``; the guid binds it to the sources, of which some files are compiled."""
    study = code.study
    reals = real_variables(code)
    flags = flag_variables(code)
    variables = [*reals, *flags]
    has_structured_names = all(STRUCTURED_NAME.fullmatch(variable.name) for variable in variables)
    outputs = [index for index, variable in enumerate(variables, start=1) if variable.causality == OUTPUT]
    sample_time = study.loop.sample_time
    description = (
        f"Sampled controller of the study {study.name}. Step it before the plant: its inputs are the samples at "
        f"the begin of a step, and its command is the plant's input during that step. {code.certificate} "
        f"Not generated: {'; '.join(not_generated(study))}."
    )
    elements = [variable_element(variable, reference, "Real") for reference, variable in enumerate(reals)]
    elements += [variable_element(variable, reference, "Integer") for reference, variable in enumerate(flags)]
    return fill(
        "modelDescription.xml",
        study=attribute(study.name),
        guid=guid,
        description=attribute(description),
        tool=f"dssc_jax {version('dssc_jax')}, study {study.hash}",
        convention="structured" if has_structured_names else "flat",
        name=code.name,
        files=[element("File", {"name": name}) for name in sources],
        units=[unit_element(unit) for unit in sorted({xml_text(variable.unit) for variable in reals if variable.unit})],
        stop_time=repr(sample_time * study.loop.steps),
        sample_time=repr(sample_time),
        variables=elements,
        outputs=[element("Unknown", {"index": str(index), "dependencies": ""}) for index in outputs],
    )


def attribute(text: str) -> str:
    """A text as the value of an attribute."""
    return escape(xml_text(text), {'"': "&quot;"})


def element(tag: str, attributes: Mapping[str, str], content: str = "") -> str:
    """An element, with one element as its content or empty."""
    pairs = "".join(f' {name}="{attribute(value)}"' for name, value in attributes.items())
    return f"<{tag}{pairs}>\n  {content}\n</{tag}>" if content else f"<{tag}{pairs} />"


def xml_number(number: float) -> str:
    """A number in XML, without a digit lost."""
    if math.isfinite(number):
        return repr(float(number))
    return {math.inf: "INF", -math.inf: "-INF"}.get(number, "NaN")


def unit_element(unit: str) -> str:
    """The definition of a unit, with base units where they are known."""
    exponents = base_exponents(unit)
    if exponents is None:
        return element("Unit", {"name": unit})
    powers = {base: str(power) for base, power in exponents.items()}
    return element("Unit", {"name": unit}, element("BaseUnit", powers))


def variable_element(variable: FmuVariable, reference: int, kind: str) -> str:
    """One variable with its value reference."""
    attributes = {"name": variable.name, "valueReference": str(reference), "description": variable.meaning}
    details = {"unit": variable.unit} if variable.unit else {}
    for name, number in (("start", variable.start), ("min", variable.lower), ("max", variable.upper)):
        if number is not None:
            details[name] = xml_number(number)
    value = element(kind, details)
    return element("ScalarVariable", attributes | ROLES[variable.causality], value)
