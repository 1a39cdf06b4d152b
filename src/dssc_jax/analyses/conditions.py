"""What analyses require of a study and of their settings, each rule with its message."""

from dssc_jax.core.errors import ConfigError
from dssc_jax.study import Study


def criterion_of(study: Study) -> tuple[str, ...]:
    """The conditions for a draw to pass, in words: the requirements, or without any, that the draw stays finite."""
    requirements = tuple(requirement.text for requirement in study.requirements)
    return requirements or ("the draw stays finite",)


def require_laws(study: Study) -> None:
    """Require at least one uncertain number.

    Raises:
        ConfigError: No number has a law.
    """
    if not study.laws:
        raise ConfigError(study.source, "nothing is uncertain; give at least one number a law")


def require_share(name: str, value: float) -> None:
    """Require a probability strictly between 0 and 1.

    Args:
        name: The setting, for the message.
        value: The value of the setting.

    Raises:
        ConfigError: The value is 0, 1 or outside.
    """
    if not 0.0 < value < 1.0:
        raise ConfigError(name, f"must lie in (0, 1), got {value:g}")
