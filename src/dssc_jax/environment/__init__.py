"""What surrounds the loop: desired trajectories and disturbances. A new one is one file and one row here."""

from dssc_jax.environment import disturbances, references
from dssc_jax.types import Registry, single

REFERENCES: Registry = {
    "zero": single(references.ZERO, "regulation to the origin"),
    "sine": single(references.SINE, "offset + amplitude sin(2 pi t/period + phase)"),
    "mission": references.MISSION_ENTRY,
}
DISTURBANCES: Registry = {
    "none": single(disturbances.NONE, "no disturbance"),
    "constant": single(disturbances.CONSTANT, "a constant"),
    "step": single(disturbances.STEP, "a step at a given time"),
    "sine": single(disturbances.SINE, "amplitude sin(2 pi t/period + phase)"),
    "filtered_noise": single(disturbances.FILTERED_NOISE, "Gauss-Markov noise, exactly sampled"),
    "partition": single(disturbances.PARTITION, "d_1 + d_2 + d_3 of (30), attaining the bounds of (A1)-(A3)"),
}
