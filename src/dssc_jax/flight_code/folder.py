"""The folder of a study's controller in C: sources, bench, Makefile and recording."""

from collections.abc import Iterable, Iterator

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.json_types import Json
from dssc_jax.design.certification import mark
from dssc_jax.flight_code.bench import channels_text
from dssc_jax.flight_code.controller import FlightCode, SampledController, sampled_controllers
from dssc_jax.flight_code.cost import parameter_bytes, program_cost, state_bytes, step_cost
from dssc_jax.flight_code.fmu import ControllerFmu, controller_fmu
from dssc_jax.flight_code.header import header_text, readme_text
from dssc_jax.flight_code.monitor_recording import recorded_flights
from dssc_jax.flight_code.monitor_text import LABEL as MONITOR
from dssc_jax.flight_code.monitor_text import monitor_texts
from dssc_jax.flight_code.monitor_text import readme_lines as monitor_lines
from dssc_jax.flight_code.onboard import traced_software
from dssc_jax.flight_code.onboard_recording import recorded_ticks
from dssc_jax.flight_code.onboard_text import LABEL as SOFTWARE
from dssc_jax.flight_code.onboard_text import readme_lines as software_lines
from dssc_jax.flight_code.onboard_text import software_files, software_texts
from dssc_jax.flight_code.premises import Premises
from dssc_jax.flight_code.recording import recorded_draws, recording
from dssc_jax.flight_code.replay_bench import recording_bytes
from dssc_jax.flight_code.source import source_text
from dssc_jax.flight_code.template_files import fill, template_text
from dssc_jax.flight_code.traced_monitor import TracedMonitor, traced_monitor
from dssc_jax.lanes.unsupported import Unsupported
from dssc_jax.study import Study

RECORDED_SAMPLES = 2000
"""Default number of recorded samples of a draw, at most."""


def certificate_sentence(study: Study) -> str:
    """The verdict of Theorem 1 on the study, in a sentence.

    A study with laws is certified only if the theorem certifies every value that the laws allow.
    """
    verdict = mark(study)
    if verdict.certified is None:  # the theorem does not cover such a loop
        return f"No certificate: {verdict.reason}."
    if bool(verdict.certified.all()):
        return "Theorem 1 certifies the study's loop in continuous time, for every value of its laws."
    return "Theorem 1 does not certify the study's loop."


class FlightFolder:
    """The files of a study's controllers in C.

    Args:
        study: The study. Its sweep is ignored, and the values of uncertain gains are the medians of their laws.
        premises: The premises of the study's certificate, for a monitor of the flight; None: no monitor.

    Raises:
        ConfigError: A controller has no exact form in C.
    """

    def __init__(self, study: Study, premises: Premises | None = None) -> None:
        """Trace the controllers and, if there are any, the software on board and the monitor."""
        study = study.without_sweep()
        study.require_single_laws()
        self.code = FlightCode(study, sampled_controllers(study), certificate_sentence(study))
        self.monitor = None if premises is None else traced_monitor(self.code, premises)
        software = traced_software(study, self.code.name)
        self.software = None if software is None else software_files(software)

    def texts(self) -> dict[str, str]:
        """Contents of the text files by name.

        The folder has header and source of the controllers, the bench with its Makefile, and a README. Software on
        board and the monitor add files of their own.
        """
        name = self.code.name
        study = self.code.study.name
        further_texts: dict[str, str] = {}
        further_sections: list[str] = []
        if self.software is not None:
            further_texts |= software_texts(self.software, study)
            further_sections += software_lines(self.software)
        if self.monitor is not None:
            further_texts |= monitor_texts(self.monitor, study)
            further_sections += monitor_lines(self.monitor)
        includes = [f"include {file}" for file in further_texts if file.endswith(".mk")]
        return further_texts | {
            f"{name}_controller.h": header_text(self.code),
            f"{name}_controller.c": source_text(self.code),
            "bench.c": fill("bench.c", same_bits=template_text("same_bits.c"), hostile=template_text("hostile.c")),
            "bench_channels.h": channels_text(self.code),
            "Makefile": fill("Makefile", name=name, includes=includes),
            "README.md": readme_text(self.code, further_sections),
        }

    def fmu(self) -> ControllerFmu:
        """The same controllers as an FMU."""
        return controller_fmu(self.code)

    def recording(self, draws: int, samples: int | None) -> Iterable[bytes]:
        """The bytes of the controllers' recording, in parts.

        Args:
            draws: Number of draws; at most that of the study.
            samples: Samples of each draw; None: those of the study, at most :data:`RECORDED_SAMPLES`.

        Raises:
            ConfigError: The loop has no strict machine code, or a count is not positive.
        """
        draws, count = self._counts(draws, samples)
        draw_records = recorded_draws(self.code.study, self.code.controllers, draws, count)
        return self._with_config_errors(recording(draw_records, self.code.precision))

    def monitor_recording(self, draws: int, samples: int | None) -> Iterable[bytes]:
        """The bytes of the monitor's recording; arguments and errors as for :meth:`recording`."""
        assert self.monitor is not None
        draws, count = self._counts(draws, samples)
        flights = recorded_flights(self.code.study, self.monitor, draws, count)
        return self._with_config_errors(recording_bytes(MONITOR, flights, self.code.precision))

    def software_recording(self, draws: int, samples: int | None) -> Iterable[bytes]:
        """The bytes of the recording of the software on board; arguments and errors as for :meth:`recording`."""
        assert self.software is not None
        draws, count = self._counts(draws, samples)
        flights = recorded_ticks(self.code.study, self.software.software, draws, count)
        return self._with_config_errors(recording_bytes(SOFTWARE, flights, self.code.precision))

    def _counts(self, draws: int, samples: int | None) -> tuple[int, int]:
        """Numbers of draws and of samples to record; arguments as for :meth:`recording`.

        Raises:
            ConfigError: A number is below 1.
        """
        study = self.code.study
        if not samples:  # None or 0
            samples = min(RECORDED_SAMPLES, study.loop.steps)
        for name, count in (("draws", draws), ("samples", samples)):
            if count < 1:
                raise ConfigError(name, f"must be >= 1, got {count}")
        return min(draws, study.config.draws), samples

    def _with_config_errors(self, parts: Iterator[bytes]) -> Iterator[bytes]:
        """The parts of a recording, with a ConfigError where the lane has no strict machine code.

        The parts are computed one by one, so the error comes while they are read and not when this method is called.
        """
        try:
            yield from parts
        except Unsupported as problem:
            raise ConfigError(self.code.study.source, f"strict arithmetic cannot express {problem}") from None

    def summary(self) -> dict[str, Json]:
        """The JSON object of ``dssc-jax code --json``: the channels with their names in C and their cost."""
        study = self.code.study
        summary: dict[str, Json] = {
            "study": study.name,
            "hash": study.hash,
            "precision": self.code.precision,
            "sample_time": study.loop.sample_time,
            "certificate": self.code.certificate,
            "channels": [channel_summary(controller) for controller in self.code.controllers],
        }
        if self.monitor is not None:
            summary["monitor"] = monitor_summary(self.monitor)
        if self.software is not None:
            summary["inner_loop"] = {"prefix": self.software.software.prefix}
        return summary


def monitor_summary(monitor: TracedMonitor) -> dict[str, Json]:
    """The JSON object of the monitor: its prefix in C, its flags in the order of their bits, and its cost."""
    cost = program_cost(monitor.step.program)
    return {
        "prefix": monitor.prefix,
        "statement": monitor.premises.statement,
        "unwatched": monitor.premises.unwatched,
        "flags": {flag.name: flag.sentence for flag in monitor.premises.flags()},
        "operations": cost.operations,
        "chain": cost.chain,
    }


def channel_summary(controller: SampledController) -> dict[str, Json]:
    """The JSON object of a channel: its names in C and its cost.

    ``operations`` counts a step without telemetry, ``operations_with_telemetry`` a step with it.
    """
    cost = step_cost(controller)
    return {
        "channel": controller.channel,
        "prefix": controller.prefix,
        "parameters": {parameter.name: parameter.value for parameter in controller.parameters},
        "parameter_bytes": parameter_bytes(controller),
        "state_bytes": state_bytes(controller),
        "operations": cost.operations,
        "operations_with_telemetry": step_cost(controller, telemetry=True).operations,
        "chain": cost.chain,
        "loops": cost.loops,
    }
