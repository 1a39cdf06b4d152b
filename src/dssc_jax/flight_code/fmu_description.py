"""``modelDescription.xml`` of the controllers as an FMU for co-simulation, FMI 2.0."""

import math
import re
from collections.abc import Sequence
from importlib.metadata import version
from xml.etree import ElementTree

from dssc_jax.core.units import parse_unit
from dssc_jax.flight_code.controller import SampledController
from dssc_jax.flight_code.fmu_variables import INPUT, OUTPUT, PARAMETER, FmuVariable, flag_variables, real_variables
from dssc_jax.flight_code.header_text import not_generated
from dssc_jax.flight_code.names import identifier
from dssc_jax.study import Study

BASE: tuple[str, ...] = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
"""Base units of FMI."""

DERIVED = {
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

STRUCTURED = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(\.[A-Za-z_][A-Za-z0-9_]*)*")
FORBIDDEN = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML 1.0 cannot express at all."""


def xml_text(text: str) -> str:
    """The text without what XML cannot express, on one line."""
    return " ".join(FORBIDDEN.sub("\ufffd", text).split())


def base_exponents(unit: str) -> dict[str, int] | None:
    """Exponents of FMI's base units; None for a unit that is no product of whole powers of SI units."""
    try:
        powers = parse_unit(unit)
    except ValueError:
        return None
    total = dict.fromkeys(BASE, 0)
    for symbol, power in powers.items():
        factor = {symbol: 1} if symbol in BASE else DERIVED.get(symbol)
        if factor is None or power.denominator != 1:
            return None
        for base, exponent in factor.items():
            total[base] += exponent * int(power)
    return {base: exponent for base, exponent in total.items() if exponent}


def description_text(
    study: Study, controllers: Sequence[SampledController], certificate: str, guid: str, sources: Sequence[str]
) -> str:
    """The text of ``modelDescription.xml``.

    Args:
        study: The study.
        controllers: Its controllers.
        certificate: What is certified of the study.
        guid: Digest that binds the description to the sources.
        sources: Names of the files to compile.
    """
    reals, flags = real_variables(study, controllers), flag_variables(controllers)
    structured = all(STRUCTURED.fullmatch(each.name) for each in (*reals, *flags))
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=xml_text(study.name),
        guid=guid,
        description=xml_text(
            f"Sampled controller of the study {study.name}. Step it before the plant: its inputs are the samples at "
            f"the begin of a step, and its command is the plant's input during that step. {certificate} "
            f"Not generated: {'; '.join(not_generated(study))}."
        ),
        generationTool=f"dssc_jax {version('dssc_jax')}, study {study.hash}",
        variableNamingConvention="structured" if structured else "flat",
    )
    simulation = ElementTree.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=identifier(study.name),
        canHandleVariableCommunicationStepSize="false",
        canNotUseMemoryManagementFunctions="true",
        canGetAndSetFMUstate="true",
    )
    files = ElementTree.SubElement(simulation, "SourceFiles")
    for name in sources:
        ElementTree.SubElement(files, "File", name=name)
    add_units(root, [each.unit for each in reals])
    categories = ElementTree.SubElement(root, "LogCategories")
    for name in ("logStatusWarning", "logStatusError"):
        ElementTree.SubElement(categories, "Category", name=name)
    time = study.loop.sample_time
    ElementTree.SubElement(
        root, "DefaultExperiment", startTime="0", stopTime=repr(time * study.loop.steps), stepSize=repr(time)
    )
    variables = ElementTree.SubElement(root, "ModelVariables")
    for place, each in enumerate(reals):
        add_variable(variables, each, place, "Real")
    for place, each in enumerate(flags):
        add_variable(variables, each, place, "Integer")
    structure = ElementTree.SubElement(root, "ModelStructure")
    computed = [place for place, each in enumerate((*reals, *flags), start=1) if each.causality == OUTPUT]
    for group in ("Outputs", "InitialUnknowns"):
        entries = ElementTree.SubElement(structure, group)
        for place in computed:
            ElementTree.SubElement(entries, "Unknown", index=str(place), dependencies="")
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def xml_number(number: float) -> str:
    """A number as XML writes it, without a digit lost."""
    return repr(float(number)) if math.isfinite(number) else {math.inf: "INF", -math.inf: "-INF"}.get(number, "NaN")


def add_units(root: ElementTree.Element, units: Sequence[str]) -> None:
    """The definitions of the units, each with its base units where they are known."""
    definitions = ElementTree.SubElement(root, "UnitDefinitions")
    for unit in sorted({xml_text(unit) for unit in units if unit}):
        entry = ElementTree.SubElement(definitions, "Unit", name=unit)
        exponents = base_exponents(unit)
        if exponents is not None:
            ElementTree.SubElement(entry, "BaseUnit", {base: str(power) for base, power in exponents.items()})


def add_variable(variables: ElementTree.Element, each: FmuVariable, place: int, kind: str) -> None:
    """One variable."""
    roles = {
        PARAMETER: {"causality": "parameter", "variability": "tunable", "initial": "exact"},
        INPUT: {"causality": "input", "variability": "discrete"},
        OUTPUT: {"causality": "output", "variability": "discrete", "initial": "calculated"},
    }
    entry = ElementTree.SubElement(
        variables,
        "ScalarVariable",
        {"name": xml_text(each.name), "valueReference": str(place), "description": xml_text(each.meaning)}
        | roles[each.causality],
    )
    numbers = {"start": each.start, "min": each.least, "max": each.most}
    given = {name: xml_number(number) for name, number in numbers.items() if number is not None}
    unit = {"unit": xml_text(each.unit)} if each.unit else {}
    ElementTree.SubElement(entry, kind, unit | given)
