"""Which set-up does what Fig. 5 shows? DSSC calm while the STA, clipped to the rho of DSSC, oscillates."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

import dssc_jax as dj
from benchmarks.paper.loops import CASE_1, KAPPA_1, KAPPA_2, RHO, comparison, sta
from benchmarks.paper.monte_carlo import DURATION, Columns, Flights, fly

START = {"plant.position.0": 0.0, "plant.position.1": 20.0, "plant.velocity.0": np.pi, "plant.velocity.2": 0.1 * np.pi}
START["plant.position.2"] = 5.0
QUICK = {"plant.inner_loop.kp_attitude": 6000.0, "plant.inner_loop.kd_attitude": 150.0}
ROTORS = {"plant.vehicle.motor_lag": 0.02}
KAPPA_M = "controller.functions.kappa_m"
KEPT = {KAPPA_M: CASE_1}
LAG = 0.125  # s: 2 mu = 15/60, the attitude loop's delay at low frequency


class Setup(NamedTuple):
    """Numbers of DSSC's loop or the STA's, and what is chosen before tracing."""

    numbers: dict[str, float]
    choices: Mapping[str, Any] = MappingProxyType({})


SETUPS: dict[str, Setup] = {
    "as printed, kappa_m = kappa1/kappa2": Setup({}),
    "start on the reference, where zero is the matched predictor": Setup(START),
    "T_s = 1 ms": Setup({}, {"loop.sample_time": 0.001}),
    "T_s = 20 ms": Setup({}, {"loop.sample_time": 0.02}),
    "5 substeps": Setup({}, {"loop.substeps": 5}),
    "explicit Euler in both": Setup({}, {"controller.discretisation": "explicit"}),
    "kappa_m ten times larger": Setup({KAPPA_M: 10.0 * KAPPA_1 / KAPPA_2}),
    "delta = 2 in tau_m too": Setup({"controller.functions.delta_m": 2.0}),
    "delta = 0.0025 in k_o too": Setup({"controller.functions.delta_o": 0.0025}),
    "kappa2 = 50 in both": Setup({KAPPA_M: KAPPA_1 / 50.0, "controller.kappa2": 50.0}),
    "kappa2 = 200 in both": Setup({KAPPA_M: KAPPA_1 / 200.0, "controller.kappa2": 200.0}),
    "attitude loop ten times faster": Setup(QUICK),
    "rotors with a lag of 20 ms": Setup({}, ROTORS),
    "Case 1's kappa_m = 4.0166": Setup(KEPT),
    "Case 1's kappa_m, rotors with a lag of 20 ms": Setup(KEPT, ROTORS),
    "Case 1's kappa_m, 1/tau_m in u_n": Setup(KEPT, {"controller.nominal.predictor_term": True}),
    "Case 1's kappa_m, T_s = 1 ms": Setup(KEPT, {"loop.sample_time": 0.001}),
}
CHOICES = [setup.choices for setup in SETUPS.values()]


def single(study: dj.Study, lag: float | None) -> dj.Study:
    """The x axis alone: x'' = -x' + u_p behind 1/(mu s + 1)^2, or behind nothing."""
    table = {name: study.table[name] for name in ("name", "loop")}
    controller = {name: value for name, value in study.table["controller"].items() if name not in ("y", "z", "psi")}
    controller = {"limit": controller.pop("x")["limit"], **controller} if "x" in controller else controller
    slow = {} if lag is None else {"unmodelled": {"kind": "lag", "order": 2, "mu": lag}}
    plant = {"kind": "normal_form", "initial": [40.0, 0.0]}
    reference = {"kind": "mission", "axis": "x"}
    return dj.Study.from_table({**table, "plant": plant, "reference": reference, "controller": controller, **slow})


def studies(choices: Mapping[str, Any]) -> tuple[dj.Study, dj.Study]:
    """The loops of DSSC and of the clipped STA."""
    form = choices.get("controller.discretisation", "implicit")
    vehicle = {name: value for name, value in choices.items() if not name.startswith("controller.")}
    other = comparison(**{"loop.duration": DURATION, **vehicle})
    return (
        comparison(**{"loop.duration": DURATION, **choices}),
        other.override({"controller": sta(form=form, clipped=True)}),
    )


def stacked(study: dj.Study, setups: list[Setup]) -> Columns:
    """The set-ups' numbers that the study's loop has, one set-up a flight; its own where a set-up is silent."""
    leaves = study.leaves()
    names = {name for setup in setups for name in setup.numbers if name in leaves}
    return {name: np.array([setup.numbers.get(name, leaves[name]) for setup in setups]) for name in sorted(names)}


def flown() -> dict[str, tuple[Flights, Flights]]:
    """Flights of DSSC and of the clipped STA; set-ups that differ in numbers only fly together."""
    found: dict[str, tuple[Flights, Flights]] = {}
    for choices in [choices for i, choices in enumerate(CHOICES) if choices not in CHOICES[:i]]:
        names = [name for name, setup in SETUPS.items() if setup.choices == choices]
        members = [SETUPS[name] for name in names]
        both = [fly(study, stacked(study, members), len(members)) for study in studies(choices)]
        for i, name in enumerate(names):
            dssc, other = (Flights(*(leaf[i : i + 1] for leaf in flights)) for flights in both)
            found[name] = dssc, other
    dssc, other = studies({})
    for name, lag in (("one degree of freedom", None), ("one degree of freedom behind 1/(0.125 s + 1)^2", LAG)):
        found[name] = fly(single(dssc, lag), {}, 1), fly(single(other, lag), {}, 1)
    return {name: found[name] for name in dict.fromkeys((*SETUPS, *found))}


def sizes(flights: Flights) -> str:
    """Oscillation over rho, or the loss."""
    if flights.lost[0]:
        return "lost"
    return ", ".join(f"{value:.2g}" for value in share(flights))


def share(flights: Flights) -> np.ndarray:
    """Oscillation over rho; one number where there is one channel."""
    return flights.swing[0] / list(RHO.values())[: flights.swing.shape[1]]


def like_figure_5(dssc: Flights, other: Flights) -> str:
    """The axes on which DSSC stays below 0.1 rho and the STA does more than twice as much."""
    if dssc.lost[0] or other.lost[0]:
        return "no"
    found = (share(dssc) < 0.1) & (share(other) > 2.0 * share(dssc)) & (share(other) > 0.1)
    axes = [axis for axis, flag in zip(RHO, found, strict=False) if flag]
    return ", ".join(axes) or "no"


def rows() -> list[tuple[str, str, str, str]]:
    """The table of the page."""
    return [(name, sizes(dssc), sizes(sta_), like_figure_5(dssc, sta_)) for name, (dssc, sta_) in flown().items()]
