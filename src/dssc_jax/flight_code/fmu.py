"""The controllers of a study as an FMU for co-simulation: a zip of description, sources and a compiled library.

FMI 2.0, because nearly every tool with co-simulation imports it; what FMI 3.0 adds (clocks, single precision, arrays)
this controller does not need. Values are exchanged in float64, and a controller of float32 rounds what it is given.

References:
    Functional Mock-up Interface for Model Exchange and Co-Simulation, version 2.0.4. Modelica Association, 2022.
"""

import hashlib
import io
import platform
import shutil
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files

from dssc_jax.flight_code.controller import SampledController
from dssc_jax.flight_code.fmu_description import description_text
from dssc_jax.flight_code.fmu_variables import variables_text
from dssc_jax.flight_code.header_text import header_text
from dssc_jax.flight_code.names import identifier
from dssc_jax.flight_code.source_text import source_text
from dssc_jax.study import Study

FMI_PLATFORMS = {("Linux", "x86_64"): "linux64"}
"""Names that FMI 2.0 has for the machines for which a library is built."""

COMPILERS = ("cc", "gcc", "clang")
LIBRARY_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-fvisibility=hidden")
WRAPPER, VARIABLES_HEADER = "fmu.c", "fmu_variables.h"
ANY_TIME = (1980, 1, 1, 0, 0, 0)
"""The earliest time of a zip: the same study makes the same file."""


@dataclass(frozen=True)
class ControllerFmu:
    """The FMU of a study's controllers.

    Args:
        name: Its model identifier, which is the name of the library.
        description: The text of ``modelDescription.xml``.
        sources: The texts of the source files by name.
    """

    name: str
    description: str
    sources: dict[str, str]

    @property
    def compiled(self) -> list[str]:
        """Names of the files to compile."""
        return [name for name in self.sources if name.endswith(".c")]

    def archive(self, library: bytes | None = None) -> bytes:
        """The bytes of the FMU.

        Args:
            library: The library for this machine; None: the FMU has sources only.
        """
        contents = {"modelDescription.xml": self.description.encode()}
        contents |= {f"sources/{name}": text.encode() for name, text in self.sources.items()}
        if library is not None:
            contents[f"binaries/{machine_platform()}/{self.name}.so"] = library
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in contents.items():
                entry = zipfile.ZipInfo(name, ANY_TIME)
                entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
                archive.writestr(entry, content)
        return buffer.getvalue()


def controller_fmu(study: Study, controllers: Sequence[SampledController], certificate: str) -> ControllerFmu:
    """The FMU of a study's controllers, from the same texts as the folder of ``dssc-jax code``."""
    name = identifier(study.name)
    sources = {
        f"{name}_controller.h": header_text(study, controllers, certificate),
        f"{name}_controller.c": source_text(study, controllers, certificate),
        WRAPPER: (files("dssc_jax.flight_code") / WRAPPER).read_text(encoding="utf-8"),
    }
    compiled = [file for file in sources if file.endswith(".c")]

    def texts(guid: str) -> tuple[str, str]:
        description = description_text(study, controllers, certificate, guid, compiled)
        return description, variables_text(study, controllers, guid)

    digest = hashlib.sha256("\0".join([*texts(""), *sources.values()]).encode()).hexdigest()
    description, variables = texts(
        f"{{{'-'.join((digest[:8], *(digest[i : i + 4] for i in (8, 12, 16)), digest[20:32]))}}}"
    )
    return ControllerFmu(name, description, sources | {VARIABLES_HEADER: variables})


def machine_platform() -> str | None:
    """FMI's name of this machine; None if no library is built for it."""
    return FMI_PLATFORMS.get((platform.system(), platform.machine()))


def compiler() -> str | None:
    """The compiler that is found first."""
    return next((path for name in COMPILERS if (path := shutil.which(name))), None)


def no_library_reason() -> str | None:
    """Why no library can be built here; None if one can."""
    if machine_platform() is None:
        here = f"{platform.system()} {platform.machine()}"
        return f"libraries are built on {' and '.join(map(' '.join, FMI_PLATFORMS))} only, this is {here}"
    if compiler() is None:
        return f"no compiler is found ({', '.join(COMPILERS)})"
    return None
