"""The full UAV: vehicle, rigid body, aerodynamics, allocation, inner loops."""

from dssc_jax.models.uav.plant import UAV

__all__ = ["UAV"]
