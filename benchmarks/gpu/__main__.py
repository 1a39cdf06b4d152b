"""``python -m benchmarks.gpu``: kernels of a GPU, into docs/performance.md.

Without options: what NVIDIA's assembler makes of them, which needs no GPU. With ``--rates``: rates and bits on a GPU.
"""

import argparse
from pathlib import Path


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, prog="python -m benchmarks.gpu")
    parser.add_argument("--rates", action="store_true", help="rates and bits on this machine's GPU")
    parser.add_argument("--crazyflow", type=Path, metavar="PYTHON", help="with --rates: a Python that has crazyflow")
    options = parser.parse_args()
    if options.rates:
        from benchmarks.gpu import rates

        rates.write(options.crazyflow)
    else:
        from benchmarks.gpu import assembly

        assembly.write()


if __name__ == "__main__":
    main()
