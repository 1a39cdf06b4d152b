"""Controllers. A new one is one file and one row here; it inherits every protocol test."""

from dssc_jax.controllers.differentiators import DIFFERENTIATORS
from dssc_jax.controllers.dssc import DSSC, SSC
from dssc_jax.controllers.pi import PI
from dssc_jax.controllers.smc import SMC
from dssc_jax.controllers.sta import STA
from dssc_jax.controllers.vgsta import VGSTA
from dssc_jax.types import Registry

CONTROLLERS: Registry = {"dssc": DSSC, "ssc": SSC, "sta": STA, "vgsta": VGSTA, "pi": PI, "smc": SMC}

__all__ = ["CONTROLLERS", "DIFFERENTIATORS"]
