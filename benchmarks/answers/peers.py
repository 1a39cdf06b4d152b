"""Answers of OpenTURNS, SALib, UQpy and Monaco; runs in their virtual environment, which lacks this package.

``peers.py PYTHON MODEL BOUND TASK`` prints a line of JSON for the first answer, of a cold process, and one for the
second: the evaluations that it took, its seconds, and the answer.
"""

import json
import math
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

BEGAN = time.perf_counter()
HALF_WIDTH, NARROW = 0.01, 0.001
SOBOL_HALF_WIDTH = 0.05
FIRST_ROWS, MOST_ROWS = 256, 32_768
NORMAL = 1.959964
BLOCKS = 10
VARIATION = 0.13  # leaves a factor of 1.3 in 95 % of the cases
ONCE = ("OpenTURNS plain 0.1 %", "OpenTURNS subset", "UQpy subset")  # tasks that take minutes are asked once


class Evaluator:
    """The other process, with the number of evaluations that it made."""

    def __init__(self, python: str, model: str, bound: str) -> None:
        command = [python, "-m", "benchmarks.answers.evaluator", model, bound]
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(command, stdin=pipe, stdout=pipe, cwd=Path(__file__).parents[2])
        self.numbers = int(np.frombuffer(self.process.stdout.read(8), np.int64)[0])
        self.evaluations = 0

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Slacks of points of the unit cube, shape (n, d)."""
        points = np.ascontiguousarray(points, dtype=float)
        count = len(points)
        self.evaluations += count
        self.process.stdin.write(np.int64(count).tobytes() + points.tobytes())
        self.process.stdin.flush()
        return np.frombuffer(self.process.stdout.read(8 * count)).copy()

    def normal(self, scores: np.ndarray) -> np.ndarray:
        """Slacks of points of the standard normal space."""
        from scipy.special import ndtr

        return self(ndtr(np.atleast_2d(scores)))


def openturns_event(evaluator: Evaluator, seed: int) -> object:
    """Slack < 0 over standard normal numbers."""
    import openturns as ot

    ot.RandomGenerator.SetSeed(seed)
    ot.Log.Show(ot.Log.NONE)
    function = ot.PythonFunction(
        evaluator.numbers,
        1,
        func=lambda point: [float(evaluator.normal(np.array(point))[0])],
        func_sample=lambda sample: evaluator.normal(np.array(sample))[:, None],
    )
    vector = ot.RandomVector(ot.Normal(evaluator.numbers))
    return ot.ThresholdEvent(ot.CompositeRandomVector(function, vector), ot.Less(), 0.0)


def openturns_probability(evaluator: Evaluator, seed: int, half_width: float = HALF_WIDTH) -> object:
    """Plain Monte Carlo until the standard deviation gives the half width."""
    import openturns as ot

    algorithm = ot.ProbabilitySimulationAlgorithm(openturns_event(evaluator, seed), ot.MonteCarloExperiment())
    algorithm.setBlockSize(256)
    algorithm.setMaximumOuterSampling(10**6)
    algorithm.setMaximumCoefficientOfVariation(-1.0)
    algorithm.setMaximumStandardDeviation(half_width / NORMAL)
    algorithm.run()
    return algorithm.getResult().getProbabilityEstimate()


def openturns_importance(evaluator: Evaluator, seed: int) -> object:
    """FORM, then importance sampling around its design point."""
    import openturns as ot

    event = openturns_event(evaluator, seed)
    form = ot.FORM(ot.AbdoRackwitz(), event, ot.Point(evaluator.numbers))
    form.run()
    point = form.getResult().getStandardSpaceDesignPoint()
    around = ot.Normal(point, ot.CovarianceMatrix(evaluator.numbers))
    algorithm = ot.ProbabilitySimulationAlgorithm(event, ot.ImportanceSamplingExperiment(around))
    algorithm.setBlockSize(256)
    algorithm.setMaximumOuterSampling(200)
    algorithm.setMaximumCoefficientOfVariation(VARIATION)
    algorithm.run()
    return algorithm.getResult().getProbabilityEstimate()


def openturns_subset(evaluator: Evaluator, seed: int) -> object:
    """Subset sampling; its number of points per level is doubled until its coefficient of variation is reached."""
    import openturns as ot

    size = 1000
    while True:
        evaluator.evaluations = 0
        algorithm = ot.SubsetSampling(openturns_event(evaluator, seed))
        algorithm.setBlockSize(size // BLOCKS)
        algorithm.setMaximumOuterSampling(BLOCKS)  # of a level
        algorithm.setMaximumCoefficientOfVariation(VARIATION)
        algorithm.run()
        result = algorithm.getResult()
        if result.getCoefficientOfVariation() <= VARIATION or size >= 16_000:
            return result.getProbabilityEstimate()
        size *= 2


def openturns_sobol(evaluator: Evaluator, seed: int) -> object:
    """Saltelli's estimator; rows are doubled until every interval is narrow, and only the last sample counts."""
    import openturns as ot

    ot.RandomGenerator.SetSeed(seed)
    law = ot.JointDistribution([ot.Uniform(0.0, 1.0)] * evaluator.numbers)
    rows = FIRST_ROWS
    while True:
        inputs = ot.SobolIndicesExperiment(law, rows).generate()
        evaluator.evaluations = 0
        outputs = ot.Sample(evaluator(np.array(inputs))[:, None])
        found = ot.SaltelliSensitivityAlgorithm(inputs, outputs, rows)
        widths = []
        for interval in (found.getFirstOrderIndicesInterval(), found.getTotalOrderIndicesInterval()):
            widths.append(0.5 * np.max(np.array(interval.getUpperBound()) - np.array(interval.getLowerBound())))
        if max(widths) <= SOBOL_HALF_WIDTH:
            return list(found.getTotalOrderIndices())
        if rows >= MOST_ROWS:
            return None
        rows *= 2


def salib_sobol(evaluator: Evaluator, seed: int) -> object:
    """The same by SALib."""
    from SALib.analyze import sobol as analysis
    from SALib.sample import sobol as sampling

    names = [f"x{i}" for i in range(evaluator.numbers)]
    problem = {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}
    rows = FIRST_ROWS
    while True:
        points = sampling.sample(problem, rows, calc_second_order=False, seed=seed)
        evaluator.evaluations = 0
        found = analysis.analyze(problem, evaluator(points), calc_second_order=False, seed=seed)
        if max(found["S1_conf"].max(), found["ST_conf"].max()) <= SOBOL_HALF_WIDTH:
            return found["ST"].tolist()
        if rows >= MOST_ROWS:
            return None
        rows *= 2


def uqpy_subset(evaluator: Evaluator, seed: int) -> object:
    """Subset simulation; its number of points per level is doubled until its coefficient of variation is reached."""
    from UQpy.distributions import MultivariateNormal
    from UQpy.reliability import SubsetSimulation
    from UQpy.run_model import RunModel
    from UQpy.sampling import ModifiedMetropolisHastings, MonteCarloSampling

    class Runner(RunModel):
        """What UQpy asks of a model: rows in, values appended to a list."""

        def __init__(self) -> None:
            self.qoi_list: list[float] = []
            self.samples: list[np.ndarray] = []

        def run(self, samples: np.ndarray, append_samples: bool = True) -> None:
            """Evaluate rows."""
            rows = np.reshape(np.asarray(samples, float), (-1, evaluator.numbers))
            values = evaluator.normal(rows).tolist()
            self.qoi_list = self.qoi_list + values if append_samples else values

    size = 1000
    law = MultivariateNormal(mean=np.zeros(evaluator.numbers), cov=np.eye(evaluator.numbers))
    while True:
        evaluator.evaluations = 0
        first = MonteCarloSampling(distributions=law, nsamples=size, random_state=seed)
        walk = ModifiedMetropolisHastings(
            dimension=evaluator.numbers, log_pdf_target=law.log_pdf, n_chains=size // 10, random_state=seed
        )
        found = SubsetSimulation(
            sampling=walk,
            runmodel_object=Runner(),
            conditional_probability=0.1,
            nsamples_per_subset=size,
            samples_init=first.samples,
        )
        if found.independent_chains_CoV <= VARIATION or size >= 16_000:
            return float(found.failure_probability)
        size *= 2


def monaco_probability(evaluator: Evaluator, seed: int) -> object:
    """Plain Monte Carlo; the number of cases follows from a first answer with 512."""
    import monaco as mc
    from scipy.stats import uniform

    share = 0.0
    for cases in (512, 0):
        count = cases or math.ceil(max(share * (1.0 - share), 1e-3) * (NORMAL / HALF_WIDTH) ** 2)

        def simulate(numbers: tuple[float, ...]) -> tuple[float]:
            return (float(evaluator(np.array([numbers]))[0]),)

        functions = {
            mc.SimFunctions.PREPROCESS: lambda case: (tuple(value.val for value in case.invals.values()),),
            mc.SimFunctions.RUN: simulate,
            mc.SimFunctions.POSTPROCESS: lambda case, slack: case.addOutVal("slack", slack),
        }
        run = mc.Sim(
            name="share", ndraws=count, fcns=functions, seed=seed, singlethreaded=True, savecasedata=False,
            savesimdata=False, verbose=False, firstcaseismedian=False,
        )  # fmt: skip
        for index in range(evaluator.numbers):
            run.addInVar(name=f"x{index}", dist=uniform, distkwargs={"loc": 0.0, "scale": 1.0})
        run.runSim()
        share = float(np.mean(np.array(run.outvars["slack"].nums) < 0.0))
    return share


TASKS: dict[str, Callable[[Evaluator, int], object]] = {
    "OpenTURNS plain": openturns_probability,
    "OpenTURNS plain 0.1 %": lambda evaluator, seed: openturns_probability(evaluator, seed, NARROW),
    "OpenTURNS importance": openturns_importance,
    "OpenTURNS subset": openturns_subset,
    "OpenTURNS Sobol": openturns_sobol,
    "SALib Sobol": salib_sobol,
    "UQpy subset": uqpy_subset,
    "Monaco plain": monaco_probability,
}


def main(python: str, model: str, bound: str, task: str) -> None:
    evaluator = Evaluator(python, model, bound)
    began = BEGAN
    for seed in (1,) if task in ONCE else (1, 2):
        evaluator.evaluations = 0
        answer = TASKS[task](evaluator, seed)
        ended = time.perf_counter()
        print(
            json.dumps({"evaluations": evaluator.evaluations, "seconds": ended - began, "answer": answer}), flush=True
        )
        began = time.perf_counter()
    evaluator.process.stdin.close()
    evaluator.process.wait()


if __name__ == "__main__":
    main(*sys.argv[1:])
