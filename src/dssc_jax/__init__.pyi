"""The public names of dssc_jax, for type checkers and for ``__init__.py``, which imports a name on its first use."""

from dssc_jax import design as design, report as report
from dssc_jax import plotting
from dssc_jax.analyses import theory as theory
from dssc_jax.analyses.comparison import (
    Comparison as Comparison,
    MarginContest as MarginContest,
    compare as compare,
    compare_margins as compare_margins,
)
from dssc_jax.analyses.falsification.falsify import Falsified as Falsified, falsify as falsify
from dssc_jax.analyses.laws.law_errors import LawErrors as LawErrors, laws as laws
from dssc_jax.analyses.laws.law_ranges import LawRanges as LawRanges, law_ranges as law_ranges
from dssc_jax.analyses.loading import load as load
from dssc_jax.analyses.loop_margins import LoopMargins as LoopMargins, loop_margins as loop_margins
from dssc_jax.analyses.margins import Margins as Margins, margin as margin
from dssc_jax.analyses.noise_spectrum.spectrum import noise_spectrum as noise_spectrum
from dssc_jax.analyses.probability.probability import (
    FailureProbability as FailureProbability,
    probability as probability,
)
from dssc_jax.analyses.rare_events.importance import ImportanceSampling as ImportanceSampling
from dssc_jax.analyses.rare_events.rare import RareEvent as RareEvent, rare as rare
from dssc_jax.analyses.rare_events.splitting import Splitting as Splitting
from dssc_jax.analyses.region.lattice import RegionAxis as RegionAxis
from dssc_jax.analyses.region.safe_region import SafeRegion as SafeRegion, region as region
from dssc_jax.analyses.selection import Selection as Selection, select as select
from dssc_jax.analyses.sensitivity import Sensitivity as Sensitivity, sensitivity as sensitivity
from dssc_jax.analyses.tuning import Tuned as Tuned, tune as tune
from dssc_jax.analyses.worst_loop import WorstLoop as WorstLoop, worst_loop as worst_loop
from dssc_jax.analyses.worst_wind.flights import fly_winds as fly_winds
from dssc_jax.analyses.worst_wind.worst_wind import (
    WorstWind as WorstWind,
    switching_winds as switching_winds,
    worst_wind as worst_wind,
)
from dssc_jax.core.errors import ConfigError as ConfigError
from dssc_jax.core.native.allowed import allow_native as allow_native
from dssc_jax.engine.integration import IntegrationError as IntegrationError, integration_error as integration_error
from dssc_jax.engine.pure_functions import lane as lane, stepper as stepper
from dssc_jax.exploration import explore as explore
from dssc_jax.flight_logs.comparison import LogComparison as LogComparison, compare_log as compare_log
from dssc_jax.flight_logs.next_flight import NextFlight as NextFlight, next_flight as next_flight
from dssc_jax.flight_logs.reading.reader import FlightLog as FlightLog, read_log as read_log
from dssc_jax.proofs.prove import Proved as Proved, check_certificate as check_certificate, prove as prove
from dssc_jax.proofs.prove_vehicle import VehicleProved as VehicleProved
from dssc_jax.proofs.reach import ProvedReach as ProvedReach, proved_up_to as proved_up_to
from dssc_jax.results.analysis import Analysis as Analysis
from dssc_jax.results.export import export as export
from dssc_jax.results.mcap_recording import write_mcap as write_mcap
from dssc_jax.results.proofs import SweepProofs as SweepProofs
from dssc_jax.results.result import Result as Result
from dssc_jax.runs.prove_sweep import prove_sweep as prove_sweep
from dssc_jax.runs.run import run as run
from dssc_jax.runs.run_until import run_until as run_until
from dssc_jax.runs.trajectory import replay as replay, simulate as simulate
from dssc_jax.runs.verify import verify as verify
from dssc_jax.statistics import AcceptReject as AcceptReject, UntilWidth as UntilWidth, plan as plan
from dssc_jax.study import Study as Study
from dssc_jax.study.systems import plant_table as plant_table

plot = plotting

__version__: str
IMPORTED: float
