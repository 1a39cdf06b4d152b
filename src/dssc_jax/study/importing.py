"""Import of a user's objects, ``package.module:object``, with a remedy for each failure."""

import contextlib
import importlib
import sys
import traceback
from pathlib import Path
from typing import Any

from dssc_jax.core.errors import ConfigError, nearest

WHERE_MODULES_ARE = (
    "if it lies in the study's folder, `allow_local` finds it (in Python: sys.path.append(FOLDER)), otherwise "
    "install it or set PYTHONPATH"
)


def allow_imports(folder: str | Path) -> None:
    """Add a folder to the places from which modules are imported.

    The folder comes last in the search, so that none of its files hides an installed module.
    """
    place = str(Path(folder).resolve())
    if place not in sys.path:
        sys.path.append(place)
        importlib.invalidate_caches()


def import_object(name: str, place: str) -> Any:
    """Import a user's object by its name ``package.module:object``.

    Text that the module prints goes to the error stream, so that it does not mix with the output of a command.

    Args:
        name: Name of the object.
        place: Place of the study that names the object, for messages.

    Raises:
        ConfigError: The object cannot be imported; the message has a remedy.
    """
    module_name, _, attribute = name.partition(":")
    try:
        with contextlib.redirect_stdout(sys.stderr):
            module = importlib.import_module(module_name)
    except (Exception, SystemExit) as error:  # a module's own code may raise anything
        raise ConfigError(place, f"cannot import '{name}': {import_failure(module_name, error)}") from error
    if not hasattr(module, attribute):
        public_names = [public_name for public_name in vars(module) if not public_name.startswith("_")]
        raise ConfigError(
            place, f"cannot import '{name}': the module has no '{attribute}'; {nearest(attribute, public_names)}"
        )
    return getattr(module, attribute)


def import_failure(module_name: str, error: BaseException) -> str:
    """Reason why the import of a module failed, and the remedy, in words.

    Args:
        module_name: Name of the module that the study names.
        error: Error that the import raised.
    """
    if isinstance(error, ModuleNotFoundError) and error.name:
        if module_name.endswith(".py"):
            return f"a module is named without `.py`: '{module_name.removesuffix('.py')}'"
        is_part_of_name = f"{module_name}.".startswith(f"{error.name}.")  # the module itself, or a package above it
        if is_part_of_name:
            return f"there is no module '{error.name}'; {WHERE_MODULES_ARE}"
        return f"the module needs '{error.name}', which is not installed; install it for this Python"
    if isinstance(error, SyntaxError):
        return f"SyntaxError: {error.msg} in line {error.lineno} of {error.filename}"
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if not frame.filename.startswith("<frozen")]
    location = ""
    if len(frames) > 1:  # `import_object` is the first frame, and the line that failed the last
        location = f" in line {frames[-1].lineno} of {frames[-1].filename}"
    return f"{type(error).__name__}: {error}{location}"
