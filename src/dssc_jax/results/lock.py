"""The lock of a results folder, which admits a single writer; the system releases it when the process ends."""

import json
import os
import platform
from datetime import UTC, datetime
from pathlib import Path

from filelock import FileLock, Timeout

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError

LOCK = ".lock"  # file that is locked
HOLDER = ".writer.json"  # file with a description of the process that holds the lock


def take(folder: Path) -> FileLock:
    """Lock a folder for this process, until the lock's ``release`` is called or the process ends.

    Args:
        folder: An existing folder.

    Raises:
        ConfigError: Another process holds the lock; the message describes this process.
        OSError: The folder cannot be locked, or something other than a file is in the place of the lock.
    """
    files.require_replaceable(folder / LOCK)
    lock = FileLock(folder / LOCK)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        rule = f"is being written by {describe_holder(folder)}; wait for it, or choose another `out`"
        raise ConfigError(str(folder), rule) from None
    process = {
        "process": os.getpid(),
        "host": platform.node(),
        "since": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    try:
        files.write_text(folder / HOLDER, json.dumps(process) + "\n", durable=False)
    except OSError:
        lock.release()
        raise
    return lock


def describe_holder(folder: Path) -> str:
    """Text about the process that locked the folder last, for messages: its number, its host and the time."""
    try:
        process = json.loads(files.read_text(folder / HOLDER))
        return f"process {process['process']} on {process['host']} since {process['since']}"
    except (OSError, ValueError, KeyError, TypeError):
        return "another process"
