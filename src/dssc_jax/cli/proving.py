"""Checks of the commands that prove: are the packages installed, and do proofs cover the study?"""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec

from dssc_jax.core.errors import ConfigError
from dssc_jax.design.certification import NotCovered
from dssc_jax.study import Study


def require_proofs() -> None:
    """Require that the packages clarabel and flint, which proofs need, are installed.

    Raises:
        ConfigError: A package is not installed.
    """
    for name in ("clarabel", "flint"):
        if find_spec(name) is None:
            raise ConfigError("prove", f"needs {name}: pip install 'dssc_jax[proofs]'")


@contextmanager
def proof_coverage(study: Study) -> Iterator[None]:
    """Report :class:`NotCovered` within the context as bad input.

    Args:
        study: The study to prove, which the message names.

    Raises:
        ConfigError: In place of :class:`NotCovered`.
    """
    try:
        yield
    except NotCovered as error:
        raise ConfigError(study.source, f"is outside of what a proof covers: {error}") from None
