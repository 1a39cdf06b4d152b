"""dssc_jax: vectorised Monte Carlo robustness analysis of Dynamic Smooth Sliding Control.

Importing the package changes no setting of the process. JAX is loaded on first use. The public names stand in
``__init__.pyi``; each is imported when it is first used.
"""

import ast
import importlib
import time
from pathlib import Path
from typing import NamedTuple

__version__ = "0.1.0"
IMPORTED = time.time()
"""When this process imported the package [s since 1970]."""


class _Place(NamedTuple):
    """Where a public name is defined: the module, and the name there."""

    module: str
    name: str

    def load(self) -> object:
        """Import the object, or the module."""
        if self.module == __name__:
            return importlib.import_module(f"{self.module}.{self.name}")
        module = importlib.import_module(self.module)
        if not hasattr(module, self.name):
            return importlib.import_module(f"{self.module}.{self.name}")
        return getattr(module, self.name)


def _public_names() -> dict[str, _Place]:
    """The place of each public name, as the stub lists it: ``from place import name as name``, or ``name = module``."""
    stub = Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")
    places = {}
    for statement in ast.parse(stub).body:
        match statement:
            case ast.ImportFrom(module=str(module), names=aliases):
                places |= {alias.name: _Place(module, alias.name) for alias in aliases if alias.asname}
            case ast.Assign(targets=[ast.Name(id=name)], value=ast.Name(id=module)):
                places[name] = _Place(__name__, module)
    return places


_PLACES = _public_names()
__all__ = sorted(_PLACES)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> object:
    if name not in _PLACES:
        raise AttributeError(f"module 'dssc_jax' has no attribute '{name}'")
    return _PLACES[name].load()


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
