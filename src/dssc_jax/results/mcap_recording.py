"""A trajectory as an MCAP file, which Foxglove and Rerun open."""

from pathlib import Path

import xarray as xr

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError


def write_mcap(trajectory: xr.Dataset, path: str | Path) -> None:
    """Write a trajectory as an MCAP file.

    For a vehicle, the file has poses, a transform, the path, body rates, rotors and wind; for any other loop, it has
    only the signals.

    Args:
        trajectory: A trajectory from :func:`dssc_jax.simulate` or :func:`dssc_jax.replay`.
        path: The file; an existing file is replaced.

    Raises:
        ConfigError: The extra ``mcap`` is not installed.
        OSError: The file cannot be written.
    """
    try:
        from dssc_jax.results.mcap_messages import write_messages  # needs an optional extra
    except ImportError as error:
        rule = f"an MCAP file needs {error.name or 'mcap'}: pip install 'dssc_jax[mcap]'"
        raise ConfigError(str(path), rule) from error
    with files.replacing(Path(path)) as file:
        write_messages(trajectory, file)
