"""Registry of actuators: unmodelled dynamics in series with the plant input; a new one is one file and one row."""

from dssc_jax.core.adapters import static_unmodelled
from dssc_jax.core.contracts import NoParams
from dssc_jax.core.registry import Registry, single
from dssc_jax.core.smoothness import SMOOTH
from dssc_jax.models.actuators.backlash import BACKLASH
from dssc_jax.models.actuators.dead_zone import DEAD_ZONE
from dssc_jax.models.actuators.delay import DELAY
from dssc_jax.models.actuators.lag import LAG
from dssc_jax.models.actuators.lost_command import LOST_COMMAND
from dssc_jax.models.actuators.quantisation import QUANTISATION
from dssc_jax.models.actuators.rate_limit import RATE_LIMIT
from dssc_jax.models.actuators.rational import RATIONAL
from dssc_jax.models.actuators.saturation import SATURATION
from dssc_jax.models.actuators.transfer_function import TRANSFER_FUNCTION

NO_DYNAMICS = static_unmodelled(NoParams, lambda params, command: command, smooth=SMOOTH, continuous=True)

UNMODELLED: Registry = {
    "none": single(NO_DYNAMICS, "the command reaches the plant unchanged"),
    "lag": LAG,
    "transfer_function": single(
        TRANSFER_FUNCTION,
        "any stable proper G(mu s) with G(0) = 1, of order 1 to 6",
        mu=0.03,
        numerator=[1.0, -0.2, 0.5],
        denominator=[1.0, 0.4, 1.0],
    ),
    "rational": single(
        RATIONAL,
        "any proper transfer function of s, of order 0 to 6, with coefficients that may be uncertain",
        numerator=[1.0],
        denominator=[0.0004, 0.02, 1.0],
    ),
    "delay": single(DELAY, "a pure delay of any real number of controller samples", samples=1.25, memory=3),
    "quantisation": single(QUANTISATION, "a plant input that is a multiple of a resolution", resolution=0.3),
    "rate_limit": single(RATE_LIMIT, "a plant input that follows the command at a limited rate", rate=20.0),
    "saturation": single(SATURATION, "a plant input of limited magnitude", limit=0.7),
    "dead_zone": single(DEAD_ZONE, "small commands have no effect", half_width=0.1),
    "backlash": single(BACKLASH, "play: the plant input moves when the gap is used up", half_width=0.1),
    "lost_command": single(LOST_COMMAND, "a lost command: the last one holds", probability=0.1),
}
