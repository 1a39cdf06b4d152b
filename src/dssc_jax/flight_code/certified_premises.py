"""Read the bounds that a monitor watches from a certificate, after the verifier has accepted the certificate.

A certificate of another loop than the study's is refused.
"""

import json

from dssc_jax.closed_loop.control import is_angle
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.json_types import JsonObject
from dssc_jax.design.certification import NotCovered
from dssc_jax.flight_code.controller import channel_labels
from dssc_jax.flight_code.premises import ChannelPremises, DisturbancePremises, Premises
from dssc_jax.proofs.coverage import problem_of
from dssc_jax.proofs.problem import delay_weights
from dssc_jax.proofs.prove import check_certificate
from dssc_jax.proofs.verifier.vehicle.verdict import VehicleVerdict
from dssc_jax.proofs.verifier.verdict import ProofVerdict
from dssc_jax.study import Study

LAG_ORDERS = {(1.0, 1.0): 1, (1.0, 2.0, 1.0): 2}
"""Number of equal lags, by the denominator of G(mu s) whose numerator is 1."""
CHANNELS_OF_VEHICLE = ("x", "x", "z", "psi")
"""Name in the certificate of each channel of the loop; x stands for both horizontal channels."""
PLANE = 2
"""Number of horizontal channels, which come first; the certificate bounds the norm of their errors."""


def certified_premises(study: Study, content: object, source: str) -> Premises:
    """Verify a study's certificate, and return its premises and bounds.

    Args:
        study: The study, without a sweep.
        content: The content of the certificate's file.
        source: Name of the certificate in messages.

    Raises:
        ConfigError: The verifier rejects the certificate, or it is the certificate of another loop.
    """
    verdict = check_certificate(content)
    if not verdict.proved:
        raise ConfigError(source, f"is rejected by the verifier: {verdict.reason}")
    assert isinstance(content, dict)
    try:
        problem = json.loads(json.dumps(problem_of(study).to_dict()))  # lists and floats, as the file has them
    except NotCovered as error:
        raise ConfigError(study.source, f"is outside of what a proof covers: {error}") from None
    if problem != content["problem"]:
        entry = differing_entry(problem, content["problem"])
        raise ConfigError(
            source, f"is the certificate of another loop than the study's: `{entry}` differs; prove the study as it is"
        )
    if isinstance(verdict, VehicleVerdict):
        if verdict.nominal:
            raise ConfigError(source, "is that of a moving reference; a monitor watches a vehicle that hovers")
        return vehicle_premises(study, content, verdict)
    return axis_premises(study, content, verdict)


def differing_entry(problem: JsonObject, certified_problem: JsonObject) -> str:
    """The name of the first entry in which two different problems differ; "kind" if only their kinds differ.

    The problems differ for certain: the caller has compared them.
    """
    for name in (*problem, *certified_problem):
        if problem.get(name) != certified_problem.get(name):
            return name
    return "kind"


def vehicle_premises(study: Study, content: JsonObject, verdict: VehicleVerdict) -> Premises:
    """The premises of a vehicle's certificate, from its content and the verifier's verdict.

    Args:
        study: The study.
        content: The content of the certificate's file.
        verdict: The verifier's verdict on the certificate.
    """
    problem = content["problem"]
    channels = [vehicle_channel(study, problem, verdict, i) for i in range(len(CHANNELS_OF_VEHICLE))]
    wind_h, wind_z = problem["wind"]
    largest_distance, largest_speed = problem["channels"]["x"]["initial"]  # of both horizontal channels together
    return Premises(
        sample_time=problem["sample_time"],
        channels=tuple(channels),
        plane_start=(largest_distance, largest_speed),
        tilt=verdict.tilt,
        rotors=(verdict.rotor_min, verdict.rotor_max),
        rotor_count=problem["rotors"],
        statement=f"a hover in every wind with |w_h| <= {wind_h:g} m/s and |w_z| <= {wind_z:g} m/s",
        unwatched="Wind, mass and inertia are not measured: the monitor sees only what they do to the flight.",
    )


def vehicle_channel(study: Study, problem: JsonObject, verdict: VehicleVerdict, i: int) -> ChannelPremises:
    """The premises of one channel of a vehicle's certificate.

    Args:
        study: The study.
        problem: The problem of the certificate.
        verdict: The verifier's verdict.
        i: Position of the channel in the loop.
    """
    name = CHANNELS_OF_VEHICLE[i]
    controller = problem["channels"][name]
    bounds = verdict.bounds[name]
    largest_distance, largest_speed = controller["initial"]
    start = ((-largest_distance, largest_distance), (-largest_speed, largest_speed))
    return ChannelPremises(
        label=channel_labels(study.loop.channels)[i],
        l0=controller["l0"],
        angle=is_angle(study.loop, i),
        e=bounds["e"],
        e_dot=bounds["e_dot"],
        sigma=bounds["sigma"],
        sigma_slope=verdict.slopes[name],
        slides=True,
        start=None if i < PLANE else start,  # the horizontal channels start within bounds of the plane
        disturbance=None,
        units=study.units[i],
    )


def axis_premises(study: Study, content: JsonObject, verdict: ProofVerdict) -> Premises:
    """The premises of a certificate of one axis, from its content and the verifier's verdict.

    The certificate splits the parameters into boxes, each with a proof of its own. A bound that the proofs state is the
    largest over the boxes, so that it holds for every plant of the certificate.

    Args:
        study: The study.
        content: The content of the certificate's file.
        verdict: The verifier's verdict on the certificate.
    """
    problem = content["problem"]
    units = study.units[0]
    # of each box's proof, the first stage holds from the first sample on
    stages = [proof["stages"][0] for proof in content["proofs"]]
    depends_on_state = any(problem["by_state"])
    level = max(stage["level"] for stage in stages) if depends_on_state else problem["level"]
    slope = max(stage["slope"] for stage in stages) if depends_on_state else problem["slope"]
    lag_order = LAG_ORDERS.get(tuple(map(float, problem["denominator"])), 0)
    hidden_reason = hidden_disturbance_reason(problem, lag_order)
    disturbance_premises = None
    if not hidden_reason:
        disturbance_premises = DisturbancePremises(
            level=level,
            slope=slope,
            k_p=tuple(problem["k_p"]),
            a_p=tuple(problem["a_p"]),
            mu=tuple(problem["mu"]),
            lag_order=lag_order,
            delay_weights=delay_weights(problem["delay"]),
        )
    e, e_dot = problem["initial"][:2]  # intervals of e and e'; the state of the zero dynamics, if any, follows
    channel = ChannelPremises(
        label="",
        l0=problem["l0"],
        angle=False,
        e=verdict.largest_error,
        e_dot=None,
        sigma=max(stage["sigma"] for stage in stages),
        sigma_slope=None,
        slides=problem["rho"] is not None,
        start=(tuple(e), tuple(e_dot)),
        disturbance=disturbance_premises,
        units=units,
    )
    return Premises(
        sample_time=problem["sample_time"],
        channels=(channel,),
        plane_start=None,
        tilt=None,
        rotors=None,
        rotor_count=0,
        statement=f"one axis with |d| <= {level:g} {units.of('u')} and |d'| <= {slope:g} {units.of('u/s')}",
        unwatched=f"The disturbance is not seen: {hidden_reason}." if hidden_reason else "",
    )


def hidden_disturbance_reason(problem: JsonObject, lag_order: int) -> str:
    """The reason why the measurements do not determine the disturbance; empty if they do.

    Args:
        problem: The problem of the certificate.
        lag_order: Number of equal lags between command and plant; 0 if there is none, or if the transfer function
            between them is no chain of equal lags.
    """
    if problem["zero_a"]:
        return "the state of the zero dynamics, which acts like one, is not measured"
    if problem["sensor_lag"]:
        return "the sensor lags behind the output"
    is_of_lags = lag_order > 0 and tuple(problem["numerator"]) == (1.0,)
    if problem["denominator"] and not is_of_lags:
        return "the output of a general transfer function is not enclosed"
    return ""
