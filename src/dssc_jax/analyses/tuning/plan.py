"""The plan of a tuning: what is varied, on which draws, and under which theorem or proof."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from dssc_jax.analyses.tuning.rules import OBJECTIVE, PROVED_ERROR, WIDTH, seed_of, start_value, tune_table
from dssc_jax.analyses.tuning.search_variables import SearchCoordinates, Theorem, identity, split_parameters
from dssc_jax.closed_loop.metrics.streaming import Measure
from dssc_jax.core.errors import ConfigError, errors_in_file
from dssc_jax.proofs import SWEEP_BOXES
from dssc_jax.study import Study
from dssc_jax.study.schema import TuneTable

if TYPE_CHECKING:
    from dssc_jax.proofs.prove import AnyProved

REACH_BOXES = 1  # boxes of uncertain numbers at each value of a walk, so that a value without a proof takes little time

NumbersKey: TypeAlias = tuple[tuple[str, float], ...]
"""The loop's numbers by name, as the key under which their proof is stored."""


class ProvedAim(NamedTuple):
    """The proved number of one loop; a tuning that sets ``aim`` optimises this number.

    Args:
        value: Proved bound of |e| once settled, or the last value of another number at which the loop is proved; None
            without a proof.
        proof: The proof of that value; None without one.
        reason: Why there is no proof; empty otherwise.
    """

    value: float | None
    proof: "AnyProved | None"
    reason: str


@dataclass(frozen=True)
class Plan:
    """The settings of a tuning, read from the study's ``[tune]`` and checked.

    Args:
        study: The study without its sweep.
        table: The table ``[tune]`` of the study.
        coordinates: The tuned numbers with their bounds, mapped to unbounded search variables.
        theorem: Certifies every point; None if no certificate is required.
        seed: Seed of the training and validation draws; the final verdict uses the study's own draws.
    """

    study: Study
    table: TuneTable
    coordinates: SearchCoordinates
    theorem: Theorem | None
    seed: int
    _proofs: "dict[NumbersKey, AnyProved]" = field(default_factory=dict, repr=False, compare=False)
    _aims: dict[NumbersKey, ProvedAim] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(cls, study: Study) -> "Plan":
        """Create the plan of a study.

        Raises:
            ConfigError: The settings break a rule; the message has dotted path, rule and value of the first error.
        """
        with errors_in_file(study.source):
            return cls._of(study.without_sweep())

    @classmethod
    def _of(cls, study: Study) -> "Plan":
        """Create the plan of a study without a sweep; :meth:`of` adds the name of the study's file to errors."""
        table = tune_table(study)
        varied = dict(table.parameters)
        starts = {name: start_value(study, name, extent) for name, extent in table.parameters.items()}
        theorem = None
        expand = identity
        if table.certified:
            free, fixed = split_parameters(table.free)
            theorem = Theorem(study, fixed)
            expand = theorem.expand
            varied |= free
            starts |= {name: (low * high) ** 0.5 for name, (low, high) in free.items()}  # the geometric mean
        elif table.slack is not None:
            theorem = Theorem(study, fixed={}, option="tune.slack")
        if not varied:
            raise ConfigError("tune.parameters", "names nothing to tune; give NAME = [low, high]")
        return cls(study, table, SearchCoordinates(varied, starts, expand), theorem, seed_of(study, table))

    @property
    def measures(self) -> dict[str, Measure]:
        """The metrics that the objective and the limits name, by name."""
        by_name = {measure.name: measure for measure in self.study.measures}
        return {name: by_name[name] for name in (*self.table.objective, *self.table.limits)}

    def proof_at(self, numbers: Mapping[str, float]) -> "AnyProved":
        """Prove the study with other numbers of the loop, or return the proof that an earlier call found for them.

        The proof may be incomplete; then it has the reason.
        """
        from dssc_jax.proofs.prove import prove

        key = tuple(numbers.items())
        if key not in self._proofs:
            self._proofs[key] = prove(self.study.override(numbers), boxes=SWEEP_BOXES)
        return self._proofs[key]

    @property
    def optimises_proof(self) -> bool:
        """Whether a proved number is optimised, and not the objective on the draws."""
        return self.table.aim != OBJECTIVE

    def aim_at(self, numbers: Mapping[str, float]) -> ProvedAim:
        """Compute the proved number that is optimised, for the study with other numbers of the loop.

        For a set of numbers that an earlier call had, its result is returned again.
        """
        if self.table.aim == PROVED_ERROR:
            proof = self.proof_at(numbers)
            if proof.complete:
                return ProvedAim(proof.error, proof, reason="")
            return ProvedAim(None, None, proof.reason)
        from dssc_jax.proofs.reach import proved_up_to

        ((name, bounds),) = self.table.over.items()  # the rules of [tune] require exactly one
        key = tuple(numbers.items())
        if key not in self._aims:
            reach = proved_up_to(self.study.override(numbers), name, bounds, log=True, boxes=REACH_BOXES)
            reason = reach.reason if reach.last is None else ""
            self._aims[key] = ProvedAim(reach.proved, reach.last, reason)
        return self._aims[key]

    def proof_of_result(self, numbers: Mapping[str, float]) -> "AnyProved | None":
        """The proof to store with a result that has these numbers of the loop.

        It proves the number that was optimised, or else the loop; None if neither is required.
        """
        if self.optimises_proof:
            return self.aim_at(numbers).proof
        return self.proof_at(numbers) if self.table.proved else None

    def numbers_at(self, z: np.ndarray) -> dict[str, float]:
        """The loop's numbers at coordinates of the search, shape (n,), by dotted name."""
        one_point = z[None]
        return {name: float(values[0]) for name, values in self.coordinates.numbers(one_point).items()}

    def trial(self) -> Study:
        """The study used for training: other draws, no plot, and only the metrics that the search reads.

        A metric of a requirement is computed in any case, so ``[metrics]`` need not name it.
        """
        required = {requirement.measure.name for requirement in self.study.requirements}
        names = {self._written_name(measure) for name, measure in self.measures.items() if name not in required}
        window = self.study.config.metrics.window.entries()
        return self.study.override(
            {
                "seed": self.seed,
                "draws": self.table.draws + self.table.validation,
                "plot": {},
                "metrics": window | {"names": sorted(names)},
            }
        )

    def smoothed(self) -> Study:
        """The study used for derivatives: :meth:`trial`, with the first width of the sign if ``smoothing`` is set."""
        width = self.table.smoothing
        return self.trial() if width is None else self.trial().override({WIDTH: width})

    def _written_name(self, measure: Measure) -> str:
        """A metric's name as ``metrics.names`` has it: with a user's own metric, the module and a colon come first."""
        for name in self.study.config.metrics.names or ():
            if name.rpartition(":")[2] == measure.kind:
                return name
        return measure.kind
