"""Rates of other simulators, for a Python that has them and not this package: ``PYTHON simulators.py [NAME] [WORLDS]``.

Prints a JSON object for each one that is installed, or for the one named; ``python -m benchmarks.speed.others`` runs
it and writes the page. WORLDS is the number of crazyflow's vehicles, 4096 unless it is told.
What is nearest to our UAV's loop: one vehicle a draw, attitude control each step, Runge-Kutta of order 4 at 5 ms, no
metrics.
"""

import json
import os
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from importlib.util import find_spec
from statistics import median

CORES = len(os.sched_getaffinity(0))
STEPS, RATE, ROUNDS = 100, 200, 5


def timed(run: Callable[[], object], steps: int) -> float:
    """Median rate of steps a second."""
    run()
    times = []
    for _ in range(ROUNDS):
        began = time.perf_counter()
        run()
        times.append(time.perf_counter() - began)
    return steps / median(times)


def crazyflow() -> tuple[float, str]:
    """Worlds of one drone, sharded over the cores or GPUs."""
    import jax
    import numpy as np
    from crazyflow.sim import Sim
    from crazyflow.sim.sharding import world_mesh

    worlds = int(sys.argv[2]) if len(sys.argv) > 2 else 4096
    sim = Sim(
        n_worlds=worlds,
        dynamics="first_principles",
        control="attitude",
        integrator="rk4",
        freq=RATE,
        attitude_freq=RATE,
        force_torque_freq=RATE,
        mesh=world_mesh(jax.devices()),
    )
    sim.attitude_control(np.tile(np.array([0.0, 0.0, 0.0, 0.4], dtype=np.float32), (worlds, 1, 1)))

    def run() -> None:
        sim.step(STEPS)
        jax.block_until_ready(sim.data.states.pos)

    return timed(run, worlds * STEPS), (
        "float32; rigid body with rotor dynamics under an attitude controller; no velocity loops, wind, "
        "outer controllers, metrics or end of a draw; sharded over the devices"
    )


def rotorpy() -> tuple[float, str]:
    """A batch of vehicles in PyTorch."""
    import torch
    from rotorpy.vehicles.crazyflie_params import quad_params
    from rotorpy.vehicles.multirotor import BatchedMultirotor, BatchedMultirotorParams

    torch.set_num_threads(CORES)
    device, draws, steps = torch.device("cpu"), 1024, 20
    zero = torch.zeros(draws, 3, dtype=torch.double)
    upright = torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=torch.double).repeat(draws, 1)
    state = {"x": zero, "v": zero, "q": upright, "w": zero, "wind": zero}
    state["rotor_speeds"] = torch.full((draws, 4), 1500.0, dtype=torch.double)
    params = BatchedMultirotorParams([quad_params] * draws, draws, device)
    vehicles = BatchedMultirotor(params, draws, state, device, "cmd_ctatt", integrator="rk4")
    command = {"cmd_thrust": torch.full((draws, 1), 0.3, dtype=torch.double), "cmd_q": upright}

    def run() -> None:
        now = state
        for _ in range(steps):
            now = vehicles.step(now, command, 1.0 / RATE)

    return timed(run, draws * steps), (
        "float64; rigid body with rotor lag and drag under an attitude controller; no velocity loops, outer "
        "controllers, metrics or end of a draw; PyTorch over batches of 1024"
    )


def elodin() -> tuple[float, str]:
    """A world of a few vehicles: it compiles every vehicle anew, so that large worlds are slow."""
    import elodin as el
    from jax import numpy as jnp

    vehicles, seconds, weight = 8, 100, 9.81

    @el.map
    def gravity(force: el.Force, inertia: el.Inertia) -> el.Force:
        return force + el.SpatialForce(linear=jnp.array([0.0, 0.0, -weight]) * inertia.mass())

    @el.map
    def attitude(place: el.WorldPos, speed: el.WorldVel, force: el.Force, inertia: el.Inertia) -> el.Force:
        turn = place.angular()
        torque = -2.0 * turn.vector()[:3] - 0.5 * speed.angular()
        thrust = jnp.array([0.0, 0.0, weight]) * inertia.mass()
        return force + el.SpatialForce(linear=turn @ thrust, torque=turn @ torque)

    world = el.World()
    for number in range(vehicles):
        place = el.SpatialTransform(linear=jnp.array([0.0, 0.0, 1.0]))
        world.spawn(el.Body(world_pos=place), name=f"vehicle{number}")
    system = el.six_dof(1.0 / RATE, attitude | gravity, integrator=el.Integrator.Rk4)
    program = world.build(system, simulation_rate=float(RATE), telemetry_rate=1.0)

    def run() -> None:
        for _ in range(seconds):
            program.run(RATE)

    return timed(run, vehicles * seconds * RATE), (
        "float64; rigid body under an attitude controller, compiled by Cranelift; no rotors, velocity loops, wind, "
        f"outer controllers, metrics or end of a draw; {vehicles} vehicles on one core, stored once a second"
    )


def main() -> None:
    """Every simulator that is installed."""
    wanted = sys.argv[1:2]
    for measure in (crazyflow, rotorpy, elodin):
        name = measure.__name__
        if not find_spec(name) or (wanted and name not in wanted):
            continue
        try:
            rate, difference = measure()
            print(
                json.dumps({"name": name, "version": version(name), "rate": rate, "difference": difference}), flush=True
            )
        except Exception as error:  # another project's: whatever it raises is told, not repaired
            problem = f"did not run: {type(error).__name__}: {str(error)[:200]}"
            print(json.dumps({"name": name, "version": version(name), "rate": 0.0, "difference": problem}), flush=True)


if __name__ == "__main__":
    main()
