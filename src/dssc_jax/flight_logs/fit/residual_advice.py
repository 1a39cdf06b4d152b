"""What to do about a residual that is more than noise, in words: its likely cause first, then what else to compare."""

from collections.abc import Sequence

from dssc_jax.flight_logs.fit.prediction import declares_noise
from dssc_jax.flight_logs.reading.reader import signal_name
from dssc_jax.flight_logs.signal_warnings import SignalWarning
from dssc_jax.study import Study

REMEDY = "Compare the log's columns, units, signs and start with the study, and its initial state"
GIVE_WHAT_ACTS = "give the study what acts on the flight (wind, disturbance, sensor noise), or wider laws"


def cause_text(channel: str, causes: Sequence[SignalWarning]) -> str:
    """The likely cause of a channel's residual and what follows for the estimates, in words.

    Args:
        channel: Name of the channel.
        causes: Warnings of likely causes; those of other channels do not count.
    """
    prefix = signal_name(channel, "")
    codes = {cause.code: None for cause in causes if not cause.signal or cause.signal.startswith(prefix)}
    if codes:
        return (
            f"another warning names what may cause it ({', '.join(codes)}). Mend that first: estimates may be wrong by "
            "more than their intervals"
        )
    return (
        "the study lacks something of this flight, such as a limit or friction, or the log is not what the study takes "
        f"it for. Estimates may be wrong by more than their intervals. {REMEDY}"
    )


def advice_text(study: Study, hint: str, causes: Sequence[SignalWarning]) -> str:
    """The likely causes of a refusal, a unit or a sign first, then what to compare if it is none of them, in sentences.

    Args:
        study: The study.
        hint: The unit, sign or channel of the readings in words; empty if none.
        causes: Warnings of likely causes.
    """
    named = "".join(f". {cause.text}" for cause in causes)
    strength = "" if named else strength_hint(study)
    return f"{hint}{named}. {REMEDY}; {GIVE_WHAT_ACTS}{strength}"


def strength_hint(study: Study) -> str:
    """A hint that the flight may have met stronger gusts than the study declares; empty if it declares none."""
    if not declares_noise(study):
        return ""
    return (
        ". The study's random disturbances are part of that noise. They exceed what is accepted in about one of 20 "
        "flights at most, so this one may have met stronger ones: give their strength (std, turbulence) a larger value"
    )
