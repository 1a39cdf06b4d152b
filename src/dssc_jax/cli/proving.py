"""Requirements of the commands that prove."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec

from dssc_jax.core.errors import ConfigError
from dssc_jax.design.certification import NotCovered
from dssc_jax.study import Study


def require_proofs() -> None:
    """Require that the packages that proofs need are installed.

    Raises:
        ConfigError: A package is not installed.
    """
    for name in ("clarabel", "flint"):
        if find_spec(name) is None:
            raise ConfigError("prove", f"needs {name}: pip install 'dssc_jax[proofs]'")


@contextmanager
def proof_coverage(study: Study) -> Iterator[None]:
    """Report a study that proofs do not cover as bad input.

    Raises:
        ConfigError: :class:`NotCovered` was raised within the context.
    """
    try:
        yield
    except NotCovered as error:
        raise ConfigError(study.source, f"is outside of what a proof covers: {error}") from None
