"""Gains of the other controllers if a study does not give them, from the article's correspondences (Table 2).

PI and SSC get the gains that DSSC synthesises at the origin. The STA, in its three sampled forms, gets kappa1 and
kappa2 of the functions that approximate it, and the VGSTA also the smoothing delta. First-order sliding mode gets the
gain rho. Error pole and nominal control are DSSC's. A name may include a sampled form or a limit: ``sta_proper``,
``sta_limited``. A controller of one's own is named ``module:OBJECT``; error pole and nominal control are the study's,
its other gains have their defaults.
"""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import jax

from dssc_jax.core.errors import ConfigError, errors_under, nearest
from dssc_jax.core.quantities import nominal
from dssc_jax.core.signals import Scalar
from dssc_jax.models.controllers import CONTROLLERS
from dssc_jax.models.controllers.dssc import synthesised_gains
from dssc_jax.models.controllers.dssc_forms import DsscGains
from dssc_jax.models.controllers.gain_functions import (
    ApproximateSta1,
    ApproximateSta2,
    Field,
    SquareRoot,
    StandardSta,
    Vgsta,
    variable_gains,
)
from dssc_jax.models.controllers.modulation import ConstantModulation
from dssc_jax.study import Law, Study
from dssc_jax.study.components import field_specs, lookup
from dssc_jax.study.tables import merged

ControllerTable = dict[str, Any]
LIMITED = "limited"


class SuperTwisting(NamedTuple):
    """kappa_1 and kappa_2 in the normalisation of Table 2, and the smoothing delta."""

    kappa1: Scalar
    kappa2: Scalar
    delta: Scalar


def super_twisting(functions: Any) -> SuperTwisting:
    """The STA that the state-dependent functions approximate.

    Raises:
        ConfigError: the functions approximate no STA.
    """
    match functions:
        case SquareRoot():  # row 4 of Table 2, where both delta agree
            kappa1 = 2.0 / (functions.kappa_o * functions.tau_av)
            return SuperTwisting(kappa1, kappa1 / functions.kappa_m, functions.delta_o)
        case StandardSta():
            return SuperTwisting(functions.kappa1, functions.kappa2, 0.0)
        case ApproximateSta1() | ApproximateSta2():
            return SuperTwisting(functions.kappa1, functions.kappa2, functions.delta)
        case Field():  # here kappa2 multiplies sgn itself
            delta = 0.5 * functions.delta * functions.k_o * functions.kappa1
            return SuperTwisting(functions.kappa1, 2.0 * functions.kappa2, delta)
        case Vgsta():  # near the origin, where phi_a rules over phi_b
            coefficients = (functions.kappa_a, functions.kappa_b, functions.kappa_c, functions.kappa_d)
            at = variable_gains(0.0, 0.0, coefficients, functions.epsilon, functions.gamma)
            return SuperTwisting(at.kappa1 * functions.phi_a, at.kappa2 * functions.phi_a**2, functions.delta)
    raise ConfigError("", f"the functions '{type(functions).__name__}' approximate no super-twisting algorithm")


def ssc_gains(gains: DsscGains) -> ControllerTable:
    """The gains of SSC: the functions' values at the origin."""
    at = gains.functions.at(0.0, 0.0, nominal(gains.l0))
    constants = {"kind": "constant", **{name: float(value) for name, value in at._asdict().items()}}
    return {"functions": constants, "rho": switching_gain(gains), "predictor_start": gains.predictor_start.value}


def pi_gains(gains: DsscGains) -> ControllerTable:
    """The gains of PI that SSC synthesises: K_P = 1/(k_o tau_av), K_I = K_P/tau_m."""
    proportional, integral = synthesised_gains(gains._replace(l0=nominal(gains.l0)))
    return {"k_p": float(proportional), "k_i": float(integral)}


def sta_gains(gains: DsscGains) -> ControllerTable:
    """The gains of the STA from Table 2, row 2."""
    twisting = super_twisting(gains.functions)
    return {"kappa1": float(twisting.kappa1), "kappa2": float(twisting.kappa2), "k_n": nominal_input_gain(gains)}


def vgsta_gains(gains: DsscGains) -> ControllerTable:
    """The gains of the VGSTA: Table 1's own numbers if the functions have them, else the STA with smoothing delta."""
    names = ("phi_a", "phi_b", "kappa_a", "kappa_b", "kappa_c", "kappa_d", "epsilon", "gamma", "delta")
    if isinstance(gains.functions, Vgsta):
        numbers = {name: getattr(gains.functions, name) for name in names}
    else:
        twisting = super_twisting(gains.functions)
        numbers = dict.fromkeys(names, 0.0)
        numbers |= {"phi_a": 1.0, "kappa_d": twisting.kappa1, "gamma": twisting.kappa2, "delta": twisting.delta}
    return {name: float(value) for name, value in numbers.items()} | {"k_n": nominal_input_gain(gains)}


def smc_gains(gains: DsscGains) -> ControllerTable:
    """The gains of first-order sliding mode: the relay of DSSC without its filter."""
    return {"gain": switching_gain(gains), "k_n": nominal_input_gain(gains)}


def nominal_input_gain(gains: DsscGains) -> float:
    """k_n of the nominal control, or 1 if there is none."""
    return nominal(gains.nominal.k) if gains.nominal else 1.0


def switching_gain(gains: DsscGains) -> float:
    """The constant rho.

    Raises:
        ConfigError: rho is the norm bound.
    """
    if not isinstance(gains.rho, ConstantModulation):
        raise ConfigError("", "rho is no constant")
    return nominal(gains.rho.rho)


RIVALS: dict[str, Callable[[DsscGains], ControllerTable]] = {
    "ssc": ssc_gains,
    "pi": pi_gains,
    "sta": sta_gains,
    "vgsta": vgsta_gains,
    "smc": smc_gains,
}


def with_own_controllers(study: Study, names: Iterable[str]) -> Study:
    """The study with a table ``[compare]`` for each ``module:OBJECT`` among the names that has none.

    So a stored comparison tells, like any study, which code it refers to.
    """
    own = study.config.controller
    missing = [name for name in names if ":" in name and name != own["kind"] and name not in study.config.compare]
    if not missing:
        return study
    tables = {name: {"kind": name, **common_gains(study, name)} for name in missing}
    return study.override({"compare": {**study.config.compare, **tables}})


def common_gains(study: Study, name: str) -> ControllerTable:
    """Error pole and nominal control of the study, as far as a controller of one's own has these gains."""
    own = study.config.controller
    with errors_under(f"compare.{name}"):
        fields = field_specs(next(iter(lookup(name, CONTROLLERS).members.values())).params)
    common = [key for key in ("l0", "nominal") if key in fields]
    tables = {"": own, **{channel: own[channel] for channel in study.loop.channels if channel in own}}
    kept = {place: {key: table[key] for key in common if key in table} for place, table in tables.items()}
    return {**kept.pop(""), **{channel: table for channel, table in kept.items() if table}}


def controller_table(study: Study, name: str) -> ControllerTable:
    """The ``[controller]`` table of a controller in a comparison.

    Args:
        study: The study. Its ``[compare.NAME]`` has priority: a whole controller, or changes of ``[controller]`` if the
            kind is the same or omitted. The study's own controller is named by its kind. Others are derived from DSSC;
            for those of one's own see :func:`with_own_controllers`.
        name: Name of the table, or kind of controller, optionally with a sampled form or ``limited`` to rho.

    Raises:
        ConfigError: there is no such controller, or its gains do not follow from the study's own.
    """
    own = study.config.controller
    given = study.config.compare.get(name)
    if given is not None:
        table = {key: value for key, value in given.items() if key != "tune"}
        return merged(own, table) if table.get("kind", own["kind"]) == own["kind"] else table
    if name == own["kind"]:
        return dict(own)
    kind, _, suffix = name.partition("_")
    known = suffixed_names()
    if name not in known:
        known += study.config.compare
        raise ConfigError(f"compare.{name}", f"there is no such controller; {nearest(name, known)}")
    table = dict(own) if kind == own["kind"] else derived(study, name, kind)
    if suffix == LIMITED:
        return with_limit(study, name, table)
    return {**table, "discretisation": suffix} if suffix else table


def suffixed_names() -> list[str]:
    """Every name of a controller: its kind, alone or with one of its sampled forms or ``limited``."""
    suffixes = {kind: [*filter(None, entry.members), LIMITED] for kind, entry in CONTROLLERS.items()}
    return [*CONTROLLERS, *(f"{kind}_{suffix}" for kind in suffixes for suffix in suffixes[kind])]


def derived(study: Study, name: str, kind: str) -> ControllerTable:
    """Derive the table of another controller, channel by channel.

    Raises:
        ConfigError: its gains do not follow from the study's own.
    """
    own = study.config.controller
    if kind not in RIVALS or own["kind"] not in ("dssc", "ssc"):
        raise ConfigError(f"compare.{name}", f"cannot be derived from '{own['kind']}'; give [compare.{name}]")
    channels = study.loop.channels
    common = {key: value for key, value in own.items() if key not in channels}
    tables = {}
    for channel, gains in zip(channels, study.template.controller, strict=True):
        try:
            with jax.enable_x64(True):
                table = {"kind": kind, **RIVALS[kind](plain(gains))}
        except ConfigError as error:
            raise ConfigError(f"compare.{name}", f"{error.rule}; give [compare.{name}]") from None
        laid = merged(common, own.get(channel, {})) if channel else common
        tables[channel] = table | {key: laid[key] for key in ("l0", "nominal") if key in laid}
    return tables.get("", {"kind": kind, **tables})


def plain(gains: DsscGains) -> DsscGains:
    """Gains whose functions are constants.

    Raises:
        ConfigError: a gain is a law.
    """
    if any(isinstance(value, Law) for value in gains.functions):
        raise ConfigError("", "the functions hold a law, and a rival's gains are numbers")
    return gains


def with_limit(study: Study, name: str, table: ControllerTable) -> ControllerTable:
    """A table whose command is clipped to +-rho, for comparison with DSSC with a constant rho.

    Raises:
        ConfigError: the controller has no limit, or rho is not constant.
    """
    if table["kind"] not in ("sta", "vgsta"):
        raise ConfigError(f"compare.{name}", f"'{table['kind']}' has no limit; sta and vgsta have")
    limits = {}
    for channel, gains in zip(study.loop.channels, study.template.controller, strict=True):
        if not isinstance(gains, DsscGains):
            raise ConfigError(f"compare.{name}", "rho is DSSC's; give [compare.NAME] with a limit")
        limits[channel] = {"limit": switching_gain(gains)}
    return merged(table, limits.get("", limits))
