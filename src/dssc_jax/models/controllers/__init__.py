"""Registry of controllers; a new one is one file and one row here, covered by the protocol tests."""

from dssc_jax.core.native.fmu_tables import KIND as FMU_KIND
from dssc_jax.core.registry import Registry
from dssc_jax.models.controllers.discrete import DISCRETE_STATE_SPACE, DISCRETE_TRANSFER_FUNCTION
from dssc_jax.models.controllers.dssc import DSSC, SSC
from dssc_jax.models.controllers.fmu import FMU_CONTROLLER
from dssc_jax.models.controllers.library import KIND, LIBRARY
from dssc_jax.models.controllers.lqg import LQG
from dssc_jax.models.controllers.pi import PI
from dssc_jax.models.controllers.pid import PID
from dssc_jax.models.controllers.smc import SMC
from dssc_jax.models.controllers.sta import STA
from dssc_jax.models.controllers.state_feedback import STATE_FEEDBACK
from dssc_jax.models.controllers.vgsta import VGSTA

CONTROLLERS: Registry = {
    "dssc": DSSC,
    "ssc": SSC,
    "sta": STA,
    "vgsta": VGSTA,
    "pi": PI,
    "smc": SMC,
    "pid": PID,
    "state_feedback": STATE_FEEDBACK,
    "lqg": LQG,
    "discrete_transfer_function": DISCRETE_TRANSFER_FUNCTION,
    "discrete_state_space": DISCRETE_STATE_SPACE,
    KIND: LIBRARY,
    FMU_KIND: FMU_CONTROLLER,
}
