"""The slack of a study as a process of its own, for tools that cannot be installed beside this package.

It writes the number of uncertain numbers. Then it reads a count n and n points of the unit cube, and writes n slacks,
again and again, as 64-bit words in the machine's order.
"""

import sys

import numpy as np

from benchmarks.answers.studies import study_of
from dssc_jax.closed_loop.metrics.requirements import worst_slack
from dssc_jax.engine.batching import Engine, evaluate
from dssc_jax.engine.sampling import inside_cube, values_at

LANES = 2048


def main(model: str, bound: str) -> None:
    study = study_of(model, bound)
    engine = Engine(study, LANES)
    source = sys.stdin.buffer
    target = sys.stdout.buffer
    numbers = len(study.laws)
    target.write(np.int64(numbers).tobytes())
    target.flush()
    done = 0
    while header := source.read(8):
        count = int(np.frombuffer(header, np.int64)[0])
        points = np.frombuffer(source.read(8 * count * numbers)).reshape(count, numbers)
        results = evaluate(engine, values_at(study, inside_cube(points)), np.arange(done, done + count))
        slacks = np.maximum(worst_slack(study.requirements, results), -1e6)
        done += count
        target.write(np.asarray(slacks, float).tobytes())
        target.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
