"""The names of generated files, functions and types."""

from dssc_jax.flight_code.controller import SampledController
from dssc_jax.lanes.c_names import prefix_name, underscored
from dssc_jax.study import Study


def identifier(name: str) -> str:
    """A safe name in C that is like a study's name."""
    return prefix_name(name)


def channel_words(channels: tuple[str, ...]) -> list[str]:
    """A part of a name for each channel; like ones are numbered, and that of a single channel may be empty."""
    labels: list[str] = []
    for channel in channels:
        base = underscored(channel) or ("channel" if channel else "")
        name, count = base, 2
        while name in labels:
            name = f"{base}_{count}"
            count += 1
        labels.append(name)
    return labels


def prefix(study: Study, controller: SampledController) -> str:
    """What the names of a controller in C begin with."""
    channel = channel_words(study.loop.channels)[controller.index]
    return "_".join(filter(None, (identifier(study.name), channel)))
