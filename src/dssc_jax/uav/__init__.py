"""The full UAV: vehicle, rigid body, aerodynamics, allocation, inner loops."""

from dssc_jax.uav.plant import UAV

__all__ = ["UAV"]
