"""dssc_jax: vectorised Monte Carlo robustness analysis of Dynamic Smooth Sliding Control.

Importing the package changes no setting of the process. JAX is loaded on first use.
"""

import importlib
import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dssc_jax import design, report
    from dssc_jax import plotting as plot
    from dssc_jax.analyses import theory
    from dssc_jax.analyses.comparison import Comparison, MarginContest, compare, compare_margins
    from dssc_jax.analyses.falsification.falsify import Falsified, falsify
    from dssc_jax.analyses.loading import load
    from dssc_jax.analyses.loop_margins import LoopMargins, loop_margins
    from dssc_jax.analyses.margins import Margins, margin
    from dssc_jax.analyses.noise_spectrum.spectrum import noise_spectrum
    from dssc_jax.analyses.rare_events.rare import RareEvent, rare
    from dssc_jax.analyses.rare_events.splitting import Splitting
    from dssc_jax.analyses.region.safe_region import RegionAxis, SafeRegion, region
    from dssc_jax.analyses.sensitivity import Sensitivity, sensitivity
    from dssc_jax.analyses.tuning import Tuned, tune
    from dssc_jax.core.errors import ConfigError
    from dssc_jax.engine.integration import IntegrationError, integration_error
    from dssc_jax.engine.pure_functions import lane, stepper
    from dssc_jax.exploration import explore
    from dssc_jax.flight_logs.comparison import LogComparison, compare_log
    from dssc_jax.flight_logs.reader import FlightLog, read_log
    from dssc_jax.proofs.prove import Proved, check_certificate, prove
    from dssc_jax.proofs.reach import ProvedReach, proved_up_to
    from dssc_jax.results.analysis import Analysis
    from dssc_jax.results.export import export
    from dssc_jax.results.proofs import SweepProofs
    from dssc_jax.results.result import Result
    from dssc_jax.runs.prove_sweep import prove_sweep
    from dssc_jax.runs.run import run
    from dssc_jax.runs.run_until import run_until
    from dssc_jax.runs.trajectory import replay, simulate
    from dssc_jax.runs.verify import verify
    from dssc_jax.statistics import AcceptReject, UntilWidth, plan
    from dssc_jax.study import Study
    from dssc_jax.study.systems import plant_table

__version__ = "0.1.0"
IMPORTED = time.time()
"""When this process imported the package [s since 1970]."""
__all__ = [
    "AcceptReject",
    "Analysis",
    "Comparison",
    "ConfigError",
    "Falsified",
    "FlightLog",
    "IntegrationError",
    "LogComparison",
    "LoopMargins",
    "MarginContest",
    "Margins",
    "Proved",
    "ProvedReach",
    "RareEvent",
    "RegionAxis",
    "Result",
    "SafeRegion",
    "Sensitivity",
    "Splitting",
    "Study",
    "SweepProofs",
    "Tuned",
    "UntilWidth",
    "check_certificate",
    "compare",
    "compare_log",
    "compare_margins",
    "design",
    "explore",
    "export",
    "falsify",
    "integration_error",
    "lane",
    "load",
    "loop_margins",
    "margin",
    "noise_spectrum",
    "plan",
    "plant_table",
    "plot",
    "prove",
    "prove_sweep",
    "proved_up_to",
    "rare",
    "read_log",
    "region",
    "replay",
    "report",
    "run",
    "run_until",
    "sensitivity",
    "simulate",
    "stepper",
    "theory",
    "tune",
    "verify",
]

_HOME = {
    "ConfigError": "dssc_jax.core.errors",
    "Study": "dssc_jax.study",
    "Result": "dssc_jax.results.result",
    "export": "dssc_jax.results.export",
    "load": "dssc_jax.analyses.loading",
    "Analysis": "dssc_jax.results.analysis",
    "MarginContest": "dssc_jax.analyses.comparison",
    "RareEvent": "dssc_jax.analyses.rare_events.rare",
    "Sensitivity": "dssc_jax.analyses.sensitivity",
    "Comparison": "dssc_jax.analyses.comparison",
    "compare": "dssc_jax.analyses.comparison",
    "compare_margins": "dssc_jax.analyses.comparison",
    "LogComparison": "dssc_jax.flight_logs.comparison",
    "compare_log": "dssc_jax.flight_logs.comparison",
    "FlightLog": "dssc_jax.flight_logs.reader",
    "read_log": "dssc_jax.flight_logs.reader",
    "LoopMargins": "dssc_jax.analyses.loop_margins",
    "loop_margins": "dssc_jax.analyses.loop_margins",
    "lane": "dssc_jax.engine.pure_functions",
    "stepper": "dssc_jax.engine.pure_functions",
    "Margins": "dssc_jax.analyses.margins",
    "margin": "dssc_jax.analyses.margins",
    "noise_spectrum": "dssc_jax.analyses.noise_spectrum.spectrum",
    "RegionAxis": "dssc_jax.analyses.region.safe_region",
    "SafeRegion": "dssc_jax.analyses.region.safe_region",
    "region": "dssc_jax.analyses.region.safe_region",
    "Falsified": "dssc_jax.analyses.falsification.falsify",
    "falsify": "dssc_jax.analyses.falsification.falsify",
    "Tuned": "dssc_jax.analyses.tuning",
    "tune": "dssc_jax.analyses.tuning",
    "Proved": "dssc_jax.proofs.prove",
    "ProvedReach": "dssc_jax.proofs.reach",
    "SweepProofs": "dssc_jax.results.proofs",
    "check_certificate": "dssc_jax.proofs.prove",
    "explore": "dssc_jax.exploration",
    "prove": "dssc_jax.proofs.prove",
    "prove_sweep": "dssc_jax.runs.prove_sweep",
    "proved_up_to": "dssc_jax.proofs.reach",
    "replay": "dssc_jax.runs.trajectory",
    "IntegrationError": "dssc_jax.engine.integration",
    "integration_error": "dssc_jax.engine.integration",
    "run": "dssc_jax.runs.run",
    "simulate": "dssc_jax.runs.trajectory",
    "run_until": "dssc_jax.runs.run_until",
    "verify": "dssc_jax.runs.verify",
    "UntilWidth": "dssc_jax.statistics",
    "AcceptReject": "dssc_jax.statistics",
    "plan": "dssc_jax.statistics",
    "plant_table": "dssc_jax.study.systems",
    "sensitivity": "dssc_jax.analyses.sensitivity",
    "rare": "dssc_jax.analyses.rare_events.rare",
    "Splitting": "dssc_jax.analyses.rare_events.splitting",
}
_MODULES = {
    "design": "dssc_jax.design",
    "plot": "dssc_jax.plotting",
    "report": "dssc_jax.report",
    "theory": "dssc_jax.analyses.theory",
}


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(_HOME[name]), name)
    if name in _MODULES:
        return importlib.import_module(_MODULES[name])
    raise AttributeError(f"module 'dssc_jax' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
