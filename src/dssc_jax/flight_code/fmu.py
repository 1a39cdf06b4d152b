"""The controllers of a study as an FMU for co-simulation: a zip of description, sources and a compiled library.

The FMU has FMI 2.0, because nearly every tool with co-simulation imports it; the controllers need none of the additions
of FMI 3.0 (clocks, single precision, arrays). Values are exchanged in float64; a controller of float32 rounds them.

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

from dssc_jax.flight_code.controller import FlightCode
from dssc_jax.flight_code.fmu_description import description_text
from dssc_jax.flight_code.fmu_variables import variables_text
from dssc_jax.flight_code.header import header_text
from dssc_jax.flight_code.source import source_text
from dssc_jax.flight_code.template_files import template_text

FMI_PLATFORMS = {("Linux", "x86_64"): "linux64"}
"""FMI 2.0's name of the platform, by system and machine, where a library can be built."""

COMPILERS = ("cc", "gcc", "clang")
LIBRARY_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-fvisibility=hidden")
WRAPPER = "fmu.c"
"""Template and source with FMI's functions, which is the same for every study."""
VARIABLES_HEADER = "fmu_variables.h"
"""Header with the study's variables, which the wrapper includes."""
EARLIEST_TIME = (1980, 1, 1, 0, 0, 0)
"""The earliest time that a zip can state; with it, the same study always gives the same file."""


@dataclass(frozen=True)
class ControllerFmu:
    """The FMU of a study's controllers.

    Args:
        name: Model identifier, which is also the name of the library.
        description: Text of ``modelDescription.xml``.
        sources: Texts of the source files by name.
    """

    name: str
    description: str
    sources: dict[str, str]

    @property
    def c_files(self) -> list[str]:
        """Names of the files to compile."""
        return [name for name in self.sources if name.endswith(".c")]

    def archive(self, library: bytes | None = None) -> bytes:
        """The bytes of the FMU's zip archive, with a library for this machine; None: with sources only."""
        contents = {"modelDescription.xml": self.description.encode()}
        contents |= {f"sources/{name}": text.encode() for name, text in self.sources.items()}
        if library is not None:
            contents[f"binaries/{machine_platform()}/{self.name}.so"] = library
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in contents.items():
                entry = zipfile.ZipInfo(name, EARLIEST_TIME)
                entry.compress_type = zipfile.ZIP_DEFLATED
                entry.external_attr = 0o644 << 16  # Unix permissions
                archive.writestr(entry, content)
        return buffer.getvalue()


def controller_fmu(code: FlightCode) -> ControllerFmu:
    """The FMU of a study's controllers, from the same texts as the folder of ``dssc-jax code``.

    A digest of all texts identifies it, so that FMUs of equal texts have one identifier.

    The digest covers the texts with an empty identifier, because a text cannot contain its own digest.
    """
    sources = {
        f"{code.name}_controller.h": header_text(code),
        f"{code.name}_controller.c": source_text(code),
        WRAPPER: template_text(WRAPPER),
    }
    c_files = [file for file in sources if file.endswith(".c")]
    guid = ""  # not known yet
    contents = [description_text(code, guid, c_files), variables_text(code, guid), *sources.values()]
    guid = identifier(contents)
    sources[VARIABLES_HEADER] = variables_text(code, guid)
    return ControllerFmu(code.name, description_text(code, guid, c_files), sources)


def identifier(texts: Sequence[str]) -> str:
    """A digest of some texts in the form of a GUID: 32 hexadecimal digits in groups of 8, 4, 4, 4 and 12."""
    digest = hashlib.sha256("\0".join(texts).encode()).hexdigest()
    return f"{{{digest[:8]}-{digest[8:12]}-{digest[12:16]}-{digest[16:20]}-{digest[20:32]}}}"


def machine_platform() -> str | None:
    """FMI's name of this machine's platform; None if no library can be built for it."""
    return FMI_PLATFORMS.get((platform.system(), platform.machine()))


def compiler() -> str | None:
    """Path of the first installed compiler of :data:`COMPILERS`; None if there is none."""
    for name in COMPILERS:
        path = shutil.which(name)
        if path is not None:
            return path
    return None


def no_library_reason() -> str | None:
    """The reason why no library can be built here; None if one can."""
    if machine_platform() is None:
        platforms = " and ".join(" ".join(names) for names in FMI_PLATFORMS)
        return f"libraries are built on {platforms} only, this is {platform.system()} {platform.machine()}"
    if compiler() is None:
        return f"no compiler is found ({', '.join(COMPILERS)})"
    return None
