"""``modelDescription.xml`` of the controllers as an FMU for co-simulation, FMI 2.0."""

import math
import re
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from xml.sax.saxutils import escape

from dssc_jax.core.units import parse_unit
from dssc_jax.flight_code.controller import FlightCode
from dssc_jax.flight_code.fmu_variables import INPUT, OUTPUT, PARAMETER, FmuVariable, flag_variables, real_variables
from dssc_jax.flight_code.header import missing_parts
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
"""Attributes of FMI that tell what a variable is for, by its causality."""
STRUCTURED_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(\.[A-Za-z_][A-Za-z0-9_]*)*")
"""A name with dots, as FMI's convention "structured" allows it without quotation marks."""
NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML 1.0 cannot express."""


def xml_text(text: str) -> str:
    """The text on one line, with U+FFFD for each character that XML cannot express."""
    return " ".join(NO_XML.sub("\ufffd", text).split())


def base_exponents(unit: str) -> dict[str, int] | None:
    """A unit by its exponents of FMI's base units; None if it is no product of whole powers of SI units.

    Exponents that are 0 are left out.
    """
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
    """The text of ``modelDescription.xml``.

    Args:
        code: The controllers.
        guid: Identifier that binds the description to the sources.
        sources: Names of the files to compile.
    """
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
        f"Not generated: {'; '.join(missing_parts(study))}."
    )
    elements = [variable_element(variable, reference, "Real") for reference, variable in enumerate(reals)]
    elements += [variable_element(variable, reference, "Integer") for reference, variable in enumerate(flags)]
    units = sorted({xml_text(variable.unit) for variable in reals if variable.unit})
    return fill(
        "modelDescription.xml",
        study=attribute(study.name),
        guid=guid,
        description=attribute(description),
        tool=f"dssc_jax {version('dssc_jax')}, study {study.hash}",
        convention="structured" if has_structured_names else "flat",
        name=code.name,
        files=[element("File", {"name": name}) for name in sources],
        units=[unit_element(unit) for unit in units],
        stop_time=repr(sample_time * study.loop.steps),
        sample_time=repr(sample_time),
        variables=elements,
        outputs=[element("Unknown", {"index": str(index), "dependencies": ""}) for index in outputs],
    )


def attribute(text: str) -> str:
    """A text as the value of an attribute in XML."""
    return escape(xml_text(text), {'"': "&quot;"})


def element(tag: str, attributes: Mapping[str, str], content: str = "") -> str:
    """An element in XML, empty or with another element as its content.

    Args:
        tag: Name of the element.
        attributes: Values of the attributes, not yet escaped, by name.
        content: The element inside, as XML; empty: there is none.
    """
    pairs = "".join(f' {name}="{attribute(value)}"' for name, value in attributes.items())
    return f"<{tag}{pairs}>\n  {content}\n</{tag}>" if content else f"<{tag}{pairs} />"


def xml_number(number: float) -> str:
    """A number in XML, with all its digits.

    XML Schema writes infinity as INF, and Python as inf.
    """
    if math.isnan(number):
        return "NaN"
    if math.isinf(number):
        return "INF" if number > 0 else "-INF"
    return repr(float(number))


def unit_element(unit: str) -> str:
    """The element that defines a unit, with its base units if they are known."""
    exponents = base_exponents(unit)
    if exponents is None:
        return element("Unit", {"name": unit})
    powers = {base: str(power) for base, power in exponents.items()}
    return element("Unit", {"name": unit}, element("BaseUnit", powers))


def variable_element(variable: FmuVariable, reference: int, kind: str) -> str:
    """The element of one variable.

    Args:
        variable: The variable.
        reference: Value reference.
        kind: Type in FMI, ``Real`` or ``Integer``.
    """
    attributes = {"name": variable.name, "valueReference": str(reference), "description": variable.meaning}
    details = {"unit": variable.unit} if variable.unit else {}
    for name, number in (("start", variable.start), ("min", variable.lower), ("max", variable.upper)):
        if number is not None:
            details[name] = xml_number(number)
    value = element(kind, details)
    return element("ScalarVariable", attributes | ROLES[variable.causality], value)
