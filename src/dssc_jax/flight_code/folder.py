"""The folder of a study's controller in C: sources, bench, Makefile and recording."""

from collections.abc import Iterable, Iterator
from typing import Any

from dssc_jax.core.errors import ConfigError
from dssc_jax.design.certification import mark
from dssc_jax.flight_code.bench_text import bench_source, channels_text, makefile
from dssc_jax.flight_code.controller import SampledController, sampled_controllers
from dssc_jax.flight_code.cost import parameter_bytes, state_bytes, step_cost
from dssc_jax.flight_code.fmu import ControllerFmu, controller_fmu
from dssc_jax.flight_code.header_text import header_text, readme_text
from dssc_jax.flight_code.names import identifier, prefix
from dssc_jax.flight_code.recording import recorded_draws, recording
from dssc_jax.flight_code.source_text import source_text
from dssc_jax.lanes.unsupported import Unsupported
from dssc_jax.study import Study

RECORDED_DRAWS, RECORDED_SAMPLES = 32, 2000
"""Recorded draws, and samples of each, unless others are wanted."""


def certificate_of(study: Study) -> str:
    """What Theorem 1 says of the study, in a sentence."""
    verdict = mark(study)
    if verdict.certified is None:
        return f"No certificate: {verdict.reason}."
    if bool(verdict.certified.all()):
        return "Theorem 1 certifies the study's loop in continuous time, for every value of its laws."
    return "Theorem 1 does not certify the study's loop."


class FlightFolder:
    """The files of a study's controllers.

    Args:
        study: The study; its sweep is ignored, and uncertain gains have the medians of their laws.

    Raises:
        ConfigError: A controller has no exact form in C.
    """

    def __init__(self, study: Study) -> None:
        self.study = study.without_sweep()
        self.controllers: list[SampledController] = sampled_controllers(self.study)
        self.certificate = certificate_of(self.study)

    def texts(self) -> dict[str, str]:
        """Content of the text files by name."""
        name, given = identifier(self.study.name), (self.study, self.controllers)
        return {
            f"{name}_controller.h": header_text(*given, self.certificate),
            f"{name}_controller.c": source_text(*given, self.certificate),
            "bench.c": bench_source(),
            "bench_channels.h": channels_text(*given),
            "Makefile": makefile(self.study),
            "README.md": readme_text(*given, self.certificate),
        }

    def fmu(self) -> ControllerFmu:
        """The same controllers as an FMU."""
        return controller_fmu(self.study, self.controllers, self.certificate)

    def recording(self, draws: int = RECORDED_DRAWS, samples: int | None = None) -> Iterable[bytes]:
        """The bytes of the recording.

        Args:
            draws: Draws; at most those of the study.
            samples: Samples of each; None: those of the study, at most :data:`RECORDED_SAMPLES`.

        Raises:
            ConfigError: The loop has no strict machine code, or a count is not positive.
        """
        for name, count in (("--draws", draws), ("--samples", samples or 1)):
            if count < 1:
                raise ConfigError(name, f"must be >= 1, got {count}")
        count = samples or min(RECORDED_SAMPLES, self.study.loop.steps)
        recorded = recorded_draws(self.study, self.controllers, min(draws, self.study.config.draws), count)
        return self._guarded(recording(recorded, self.study.config.loop.precision))

    def _guarded(self, parts: Iterator[bytes]) -> Iterator[bytes]:
        try:
            yield from parts
        except Unsupported as problem:
            raise ConfigError(self.study.source, f"strict arithmetic cannot express {problem}") from None

    def summary(self) -> dict[str, Any]:
        """For JSON: the channels with their names in C and their cost."""
        channels = []
        for each in self.controllers:
            bare, full = step_cost(each), step_cost(each, telemetry=True)
            channels.append(
                {
                    "channel": each.channel,
                    "prefix": prefix(self.study, each),
                    "parameters": {parameter.name: parameter.value for parameter in each.parameters},
                    "parameter_bytes": parameter_bytes(each),
                    "state_bytes": state_bytes(each),
                    "operations": bare.operations,
                    "operations_with_telemetry": full.operations,
                    "chain": bare.chain,
                    "loops": bare.loops,
                }
            )
        return {
            "study": self.study.name,
            "hash": self.study.hash,
            "precision": self.study.config.loop.precision,
            "sample_time": self.study.loop.sample_time,
            "certificate": self.certificate,
            "channels": channels,
        }
