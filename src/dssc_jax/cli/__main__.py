"""Run the command line as ``python -m dssc_jax.cli``."""

import sys

from dssc_jax.cli.main import main

if __name__ == "__main__":  # the processes of a local cluster import this module too
    if not sys.flags.safe_path:
        del sys.path[0]  # the current folder: a study's modules come from there with --allow-local only
    main()
