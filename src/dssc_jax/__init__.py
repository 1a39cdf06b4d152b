"""dssc_jax: vectorised Monte Carlo robustness analysis of Dynamic Smooth Sliding Control.

Importing the package sets compiler flags (see :mod:`dssc_jax.xla`) and nothing else; JAX is loaded on first use.
"""

import importlib
from typing import TYPE_CHECKING, Any

from dssc_jax import xla

xla.configure()

if TYPE_CHECKING:
    from dssc_jax import design, report, theory
    from dssc_jax import plotting as plot
    from dssc_jax.comparison import Comparison, compare, compare_margins
    from dssc_jax.errors import ConfigError
    from dssc_jax.exports import export
    from dssc_jax.falsification import Falsified, falsify
    from dssc_jax.global_sensitivity import sensitivity
    from dssc_jax.loading import load
    from dssc_jax.margins import Margins, margin
    from dssc_jax.rare_events import Splitting, rare
    from dssc_jax.results import Result
    from dssc_jax.running import run
    from dssc_jax.statistics import AcceptReject, UntilWidth, plan
    from dssc_jax.stopping import run_until
    from dssc_jax.study import Study
    from dssc_jax.trajectories import replay, simulate
    from dssc_jax.tuning import Tuned, tune
    from dssc_jax.verification import verify

__version__ = "0.1.0"
__all__ = [
    "AcceptReject",
    "Comparison",
    "ConfigError",
    "Falsified",
    "Margins",
    "Result",
    "Splitting",
    "Study",
    "Tuned",
    "UntilWidth",
    "compare",
    "compare_margins",
    "design",
    "export",
    "falsify",
    "load",
    "margin",
    "plan",
    "plot",
    "rare",
    "replay",
    "report",
    "run",
    "run_until",
    "sensitivity",
    "simulate",
    "theory",
    "tune",
    "verify",
]

_HOME = {
    "ConfigError": "dssc_jax.errors",
    "Study": "dssc_jax.study",
    "Result": "dssc_jax.results",
    "export": "dssc_jax.exports",
    "load": "dssc_jax.loading",
    "Comparison": "dssc_jax.comparison",
    "compare": "dssc_jax.comparison",
    "compare_margins": "dssc_jax.comparison",
    "Margins": "dssc_jax.margins",
    "margin": "dssc_jax.margins",
    "Falsified": "dssc_jax.falsification",
    "falsify": "dssc_jax.falsification",
    "Tuned": "dssc_jax.tuning",
    "tune": "dssc_jax.tuning",
    "replay": "dssc_jax.trajectories",
    "run": "dssc_jax.running",
    "simulate": "dssc_jax.trajectories",
    "run_until": "dssc_jax.stopping",
    "verify": "dssc_jax.verification",
    "UntilWidth": "dssc_jax.statistics",
    "AcceptReject": "dssc_jax.statistics",
    "plan": "dssc_jax.statistics",
    "sensitivity": "dssc_jax.global_sensitivity",
    "rare": "dssc_jax.rare_events",
    "Splitting": "dssc_jax.rare_events",
}
_MODULES = {
    "design": "dssc_jax.design",
    "plot": "dssc_jax.plotting",
    "report": "dssc_jax.report",
    "theory": "dssc_jax.theory",
}


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(_HOME[name]), name)
    if name in _MODULES:
        return importlib.import_module(_MODULES[name])
    raise AttributeError(f"module 'dssc_jax' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
