"""dssc-jax library: a controller in C as a shared object."""

import json
from pathlib import Path

from dssc_jax.cli.analysing import write_or_refuse
from dssc_jax.cli.declarations.flight import Library
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.native_build import build_library
from dssc_jax.cli.output import say
from dssc_jax.console.libraries import library_summary, show_library
from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.native.allowed import allow_native, native_digest
from dssc_jax.core.native.libraries import NativeLibrary
from dssc_jax.flight_code.template_files import template_text

TEMPLATE = "library.c"
"""Name of the example among the package's templates."""


def run(options: Library) -> int:
    """Write the template, or build the library and show what it exports."""
    if options.template is not None:
        return write_template(options.template, options.sources or [])
    if not options.sources:
        raise ConfigError("FILE.c", "is missing; `template` writes an example")
    file = library_file(options)
    say(f"this command runs native code {file}, SHA-256 {native_digest(file)}")
    library = allow_native(file)
    if not isinstance(library, NativeLibrary):
        raise ConfigError(str(file), 'is an FMU; a study runs it by kind = "fmu"')
    if options.as_json:
        print(json.dumps(library_summary(library), allow_nan=False))
    else:
        show_library(library, file)
    return DONE


def write_template(path: Path, sources: list[Path]) -> int:
    """Write an example of a controller to a new file, and return the exit code.

    Args:
        path: The file.
        sources: Source files that the user names, which must be none.

    Raises:
        ConfigError: Source files are named, or the file exists or cannot be written.
    """
    if sources:
        raise ConfigError("--template", "writes a file and builds nothing; omit FILE.c")
    write_or_refuse(path, lambda: files.create_text(path, template_text(TEMPLATE)))
    say(f"wrote {path}; build it with dssc-jax library {path}")
    return DONE


def library_file(options: Library) -> Path:
    """Return the path of the library: the shared object that the user names, or one that is built from sources.

    Raises:
        ConfigError: A shared object is among several files, the sources do not compile, or the library cannot be
            written.
    """
    sources = options.sources or []
    first = sources[0]
    if any(source.suffix == ".so" for source in sources):
        if len(sources) > 1 or options.out is not None:
            raise ConfigError(str(first), "is a shared object, which is shown alone; give sources (.c) to build one")
        return first
    out = options.out or first.with_suffix(".so")
    content = build_library(sources, options.include or [])
    write_or_refuse(out, lambda: files.write_bytes(out, content))
    return out
