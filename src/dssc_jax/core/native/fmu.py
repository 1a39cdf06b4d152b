"""An FMU's description and library, checked before anything is connected to it."""

import atexit
import re
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.native.fmi import VERSIONS, FmiCalls, FmiError, fmpy
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.units import parse_unit

if TYPE_CHECKING:
    from fmpy.model_description import ModelDescription, ModelVariable

ZIP = b"PK\x03\x04"
"""The first bytes of an FMU, which is a zip archive."""

UNPACKED = ExitStack()
"""The folders of unpacked FMUs, which stay until the process ends because the FMUs' libraries may read them."""

atexit.register(UNPACKED.close)

REAL_TYPES = ("Real", "Float64")
"""Names of the type of numbers that can be connected, in FMI 2.0 and 3.0."""

INPUT = "input"
OUTPUT = "output"
PARAMETER = "parameter"
CONSTANT = "constant"
EXACT = "exact"


@dataclass(frozen=True)
class FmuVariable:
    """A scalar real variable of an FMU.

    Args:
        name: Name in the FMU.
        reference: Value reference.
        quantity: Unit, meaning and range; the unit is empty if this package cannot read it.
        causality: FMI's causality: ``parameter``, ``input``, ``output``, ``local`` and so on.
        start: Start value; None: the FMU states none.
        settable: Whether a study may set the value before t = 0: for a parameter, an input or an exact initial value.
    """

    name: str
    reference: int
    quantity: Quantity
    causality: str
    start: float | None
    settable: bool


@dataclass(frozen=True)
class NativeFmu:
    """A loaded FMU for co-simulation.

    Args:
        file: Path of the file from which the FMU was read.
        sha256: SHA-256 digest of the file's content, in hexadecimal.
        version: Version of FMI, a key of :data:`~dssc_jax.core.native.fmi.VERSIONS`.
        model: Name of the FMU's model.
        variables: The scalar real variables by name.
        unusable: Description of every other variable by name, such as ``of type Boolean`` or ``an array of Real``.
        step_size: Step of the FMU's default experiment [s]; None: the FMU states none.
        calls: The functions of the FMU's library.
    """

    file: str
    sha256: str
    version: str
    model: str
    variables: Mapping[str, FmuVariable] = field(compare=False)
    unusable: Mapping[str, str] = field(compare=False)
    step_size: float | None
    calls: FmiCalls = field(compare=False, repr=False)

    def __hash__(self) -> int:
        """Return the hash of the content's digest, because the mappings among the fields have no hash."""
        return hash(self.sha256)

    def variable(self, name: object, place: str, causality: str) -> FmuVariable:
        """Find a variable by its name in the FMU.

        Args:
            name: The name in the FMU; anything but a text is refused.
            place: Field of the study that names the variable, for messages.
            causality: The causality that the variable must have.

        Raises:
            ConfigError: The FMU has no such variable, or the variable is no scalar real one or has another causality.
        """
        if not isinstance(name, str):
            raise ConfigError(place, f"must be the name of a variable of '{self.file}', got {name!r}")
        if name in self.unusable:
            raise ConfigError(place, f"'{name}' of '{self.file}' is {self.unusable[name]}; must be one real number")
        if name not in self.variables:
            hint = nearest(name, self.names_with(causality))
            raise ConfigError(place, f"'{self.file}' has no variable '{name}'; {hint}")
        variable = self.variables[name]
        if variable.causality != causality:
            rule = f"must be an {causality}, it has the causality {variable.causality}"
            valid = f"the {causality}s of '{self.file}' are {', '.join(sorted(self.names_with(causality))) or 'none'}"
            raise ConfigError(place, f"'{name}' {rule}; {valid}")
        return variable

    def names_with(self, causality: str) -> list[str]:
        """Return the names of the scalar real variables that have a causality, such as ``input``."""
        return [name for name, variable in self.variables.items() if variable.causality == causality]

    def references_with(self, causality: str) -> list[int]:
        """The value references of the scalar real variables that have a causality, in the order of ``names_with``."""
        return [variable.reference for variable in self.variables.values() if variable.causality == causality]

    def parameter(self, name: str, place: str) -> FmuVariable:
        """Find a variable that a study sets before t = 0, by its name in a study (:func:`field_name`).

        Args:
            name: The name in the study.
            place: Field of the study that names the variable, for messages.

        Raises:
            ConfigError: The FMU has no such variable, or the variable cannot be set.
        """
        by_field = {field_name(variable_name): variable_name for variable_name in (*self.variables, *self.unusable)}
        variable_name = by_field.get(name)
        if variable_name is None:
            raise ConfigError(place, self._no_parameter(name, by_field))
        subject = f"'{variable_name}' of '{self.file}'"
        if variable_name in self.unusable:
            raise ConfigError(place, f"{subject} is {self.unusable[variable_name]}; must be one real number")
        variable = self.variables[variable_name]
        if not variable.settable:
            rule = "must be a parameter, an input or an exact initial value"
            raise ConfigError(place, f"{rule}; {subject} has the causality {variable.causality}")
        return variable

    def _no_parameter(self, name: str, by_field: Mapping[str, str]) -> str:
        """Return the message about a name in a study that belongs to no variable.

        Args:
            name: The name in the study.
            by_field: Name in the FMU of each variable, by its name in a study.
        """
        expected_name = field_name(name)
        if expected_name in by_field:
            return f"must be written {expected_name} for the FMU's variable '{by_field[expected_name]}'"
        usable = {key: self.variables[full] for key, full in by_field.items() if full in self.variables}
        valid_names = [key for key, variable in usable.items() if variable.settable]
        return f"'{self.file}' has no such parameter; {nearest(name, valid_names)}"


def field_name(name: str) -> str:
    """Return the name that an FMU's variable has in a study: ``body.m[1]`` becomes ``body_m_1``."""
    with_underscores = re.sub(r"\W", "_", name, flags=re.ASCII)
    return re.sub(r"_+", "_", with_underscores).strip("_")


def is_fmu(content: bytes) -> bool:
    """Whether the content of a file is an FMU, and not a shared object."""
    return content.startswith(ZIP)


def loaded_fmu(path: Path, content: bytes, digest: str) -> NativeFmu:
    """Unpack an FMU into a temporary folder, which lasts as long as the process, and load its library.

    Args:
        path: The file, for messages.
        content: The file's content.
        digest: SHA-256 digest of the content.

    Raises:
        ConfigError: FMPy is missing, or the FMU cannot run here. Such an FMU is damaged, has no co-simulation, another
            version of FMI or no library for this machine, needs its tool, or allows a process only one instance.
    """
    with ExitStack() as stack:
        place = Path(stack.enter_context(TemporaryDirectory(prefix="dssc-jax-fmu-")))
        fmu = unpacked_fmu(path, content, digest, place)
        UNPACKED.push(stack.pop_all())  # a folder that failed to load is deleted at once
    return fmu


def unpacked_fmu(path: Path, content: bytes, digest: str, place: Path) -> NativeFmu:
    """Unpack an FMU into a folder and load its library.

    Args:
        path: The file, for messages.
        content: The file's content.
        digest: SHA-256 digest of the content.
        place: The folder.

    Raises:
        ConfigError: FMPy is missing, or the FMU cannot run here; see :func:`loaded_fmu`.
    """
    modules = fmpy()
    archive = place / "archive.fmu"
    files.write_bytes(archive, content, durable=False)
    unpacked = place / "unpacked"
    try:
        modules.package.extract(str(archive), unzipdir=str(unpacked))
        text = files.read_bytes(unpacked / "modelDescription.xml").decode("utf-8", "replace")
    except Exception as error:  # FMPy raises errors of many kinds
        raise unreadable(path, error) from None
    version = required_version(path, text)
    try:
        description = modules.package.read_model_description(str(unpacked))
    except Exception as error:
        raise unreadable(path, error) from None
    require_co_simulation(path, description)
    require_library(path, description, unpacked, modules.package.platform, modules.package.platform_tuple)
    variables, unusable = scalar_variables(description)
    try:
        calls = VERSIONS[version](unpacked, description)
    except Exception as error:  # of the system's loader, or of FMPy
        raise ConfigError("file", f"'{path}' cannot be loaded: {first_lines(error)}") from None
    experiment = description.defaultExperiment
    step = float(experiment.stepSize) if experiment is not None and experiment.stepSize else None
    return NativeFmu(
        file=str(path.resolve()),
        sha256=digest,
        version=version,
        model=description.modelName,
        variables=variables,
        unusable=unusable,
        step_size=step,
        calls=calls,
    )


def unreadable(path: Path, error: Exception) -> ConfigError:
    """Return the error for a file that is no FMU or a damaged one, with the text of FMPy's error."""
    return ConfigError("file", f"'{path}' is no FMU that can be read: {first_lines(error)}")


def scalar_variables(description: "ModelDescription") -> tuple[dict[str, FmuVariable], dict[str, str]]:
    """Return the scalar real variables of an FMU by name, and descriptions of all other variables by name."""
    variables = {}
    unusable = {}
    for variable in description.modelVariables:
        if variable.dimensions:
            unusable[variable.name] = f"an array of {variable.type}"
        elif variable.type in REAL_TYPES:
            variables[variable.name] = described_variable(variable)
        else:
            unusable[variable.name] = f"of type {variable.type}"
    return variables, unusable


def required_version(path: Path, text: str) -> str:
    """Return the version of FMI that an FMU has, as a key of :data:`VERSIONS`.

    Args:
        path: The file, for messages.
        text: Content of the FMU's ``modelDescription.xml``.

    Raises:
        ConfigError: This package cannot run that version.
    """
    match = re.search(r"""fmiVersion\s*=\s*["']([^"']*)["']""", text)
    stated_version = match[1] if match else "none"
    for version in VERSIONS:
        if stated_version.startswith(version):
            return version
    raise ConfigError("file", f"'{path}' must have FMI {' or '.join(VERSIONS)}, it has {stated_version}")


def require_co_simulation(path: Path, description: "ModelDescription") -> None:
    """Require that an FMU has co-simulation, may have many instances, and runs without its tool.

    Raises:
        ConfigError: The FMU lacks co-simulation, allows a process only one instance, or needs its tool.
    """
    simulation = description.coSimulation
    if simulation is None:
        kinds = {"model exchange": description.modelExchange, "scheduled execution": description.scheduledExecution}
        has = " and ".join(name for name, kind in kinds.items() if kind is not None)
        rule = "must be for co-simulation, which has a solver of its own"
        raise ConfigError("file", f"'{path}' {rule}; it is for {has} only: export it again for co-simulation")
    if simulation.canBeInstantiatedOnlyOncePerProcess:
        rule = "says canBeInstantiatedOnlyOncePerProcess, and each draw needs an instance of its own"
        raise ConfigError("file", f"'{path}' {rule}; export it without global variables")
    if simulation.needsExecutionTool:
        raise ConfigError("file", f"'{path}' needs the tool that made it; export it with all that it runs")


def require_library(path: Path, description: "ModelDescription", unpacked: Path, *platforms: str) -> None:
    """Require that an FMU contains a library for this machine.

    Args:
        path: The FMU's file, for messages.
        description: The description of the FMU.
        unpacked: The folder of the unpacked FMU.
        platforms: Names of this machine's platform, in FMI 2.0 and 3.0.

    Raises:
        ConfigError: The FMU has no such library.
    """
    name = description.coSimulation.modelIdentifier  # type: ignore[union-attr]
    binaries = unpacked / "binaries"
    for platform in platforms:
        folder = binaries / platform
        if folder.is_dir() and any(folder.glob(f"{name}.*")):
            return
    present = sorted(folder.name for folder in binaries.iterdir()) if binaries.is_dir() else []
    has = f"it has {', '.join(present)}" if present else "it has none"
    hint = "; its sources can be compiled: fmpy compile FILE" if (unpacked / "sources").is_dir() else ""
    raise ConfigError("file", f"'{path}' must have a library for {platforms[0]}, {has}{hint}")


def described_variable(variable: "ModelVariable") -> FmuVariable:
    """Return a scalar real variable of an FMU, given FMPy's description of it.

    Where the variable has no unit or bound of its own, those of its declared type hold.
    """
    declared_type = variable.declaredType
    unit = readable_unit(variable.unit or getattr(declared_type, "unit", None) or "")
    low = bound(variable.min or getattr(declared_type, "min", None))
    high = bound(variable.max or getattr(declared_type, "max", None))
    causality = variable.causality or "local"
    is_exact = variable.initial == EXACT and variable.variability != CONSTANT
    return FmuVariable(
        name=variable.name,
        reference=variable.valueReference,
        quantity=Quantity(unit, variable.description or variable.name, at_least=low, at_most=high),
        causality=causality,
        start=None if variable.start is None else float(variable.start),
        settable=causality in (PARAMETER, INPUT) or is_exact,
    )


def bound(text: str | None) -> float | None:
    """Return a bound of a variable's range as a number; None if there is no bound."""
    return None if text is None else float(text)


def readable_unit(text: str) -> str:
    """Return a unit in the form of this package, ``N m/s^2`` for ``N.m/s2``; empty if the unit cannot be read."""
    factors = text.replace(".", " ")
    unit = re.sub(r"([^\W\d_])(-?\d+)", r"\1^\2", factors)  # s^2 for s2
    try:
        parse_unit(unit or "1")
    except ValueError:
        return ""
    return unit


def first_lines(error: BaseException) -> str:
    """Return the first two lines of an error's text as one line; FMPy's validation names the rule in the second.

    An error without text gives the name of its type.
    """
    lines = str(error).strip().splitlines()
    return " ".join(line.strip() for line in lines[:2]) or type(error).__name__


def failure(fmu: NativeFmu, error: FmiError) -> ConfigError:
    """Return the error for an FMU that fails before any draw is flown, with the last message that the FMU logged."""
    last_message = f": {fmu.calls.last_message}" if fmu.calls.last_message else ""
    return ConfigError("file", f"'{fmu.file}' cannot be started: {error}{last_message}")
