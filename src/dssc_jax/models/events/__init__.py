"""Registry of events, which change a loop at a time: one file each, one row here."""

from dssc_jax.core.registry import Registry, single
from dssc_jax.models.events.growing_delay import GROWING_DELAY
from dssc_jax.models.events.payload import PAYLOAD
from dssc_jax.models.events.rotor import ROTOR
from dssc_jax.models.events.sensor_outage import SENSOR_OUTAGE
from dssc_jax.models.events.voltage_sag import VOLTAGE_SAG
from dssc_jax.models.events.wind_shear import WIND_SHEAR

EVENTS: Registry = {
    "rotor": single(ROTOR, "a rotor gives a share of its thrust, or none", at=5.0, rotor=2, effectiveness=0.5),
    "payload": single(PAYLOAD, "a mass is picked up, or dropped", at=5.0, mass=-0.5, offset=[0.1, 0.0, -0.1]),
    "voltage_sag": single(VOLTAGE_SAG, "the voltage falls, and with it the speed of all rotors", at=5.0, voltage=0.9),
    "wind_shear": single(WIND_SHEAR, "a wind that changes with height sets in", at=5.0, gradient=[0.2, 0.0, 0.0]),
    "sensor_outage": single(SENSOR_OUTAGE, "a sensor shows its last reading for a while", at=5.0, duration=1.0),
    "growing_delay": single(GROWING_DELAY, "commands arrive later and later", at=5.0, rate=0.01),
}

__all__ = ["EVENTS"]
