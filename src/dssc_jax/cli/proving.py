"""Shared by the commands that prove: require the packages that proofs need."""

from importlib.util import find_spec

from dssc_jax.core.errors import ConfigError


def require_proofs() -> None:
    """Require that what proofs need is installed.

    Raises:
        ConfigError: it is not.
    """
    for name in ("clarabel", "flint"):
        if find_spec(name) is None:
            raise ConfigError("prove", f"needs {name}: pip install 'dssc_jax[proofs]'")
