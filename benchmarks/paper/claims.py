"""The article's sentences, the numbers that stand for them, and whether they hold."""

from typing import NamedTuple

import numpy as np
import xarray as xr

from benchmarks.paper.loops import AXES, RHO, Runs
from benchmarks.paper.signals import (
    SECONDS,
    SMOOTH,
    correlation,
    fast_part,
    gap,
    lost,
    per_axis,
    rise,
    rms,
    text,
    window,
)


class Claim(NamedTuple):
    """A sentence of the article, the number that stands for it, what was measured, and whether it holds."""

    sentence: str
    number: str
    measured: str
    verdict: str


def before_disturbance(
    full: xr.Dataset, simple: xr.Dataset, start: float = 5.0, end: float = SECONDS - 0.5 * SMOOTH
) -> list[Claim]:
    """Fig. 3 before the disturbance; the window ends where the moving average begins to see it."""
    errors = per_axis(lambda a: gap(full, simple, f"{a}_e", start, end))
    waves = per_axis(lambda a: fast_part(full, f"{a}_u", start, end) / fast_part(simple, f"{a}_u", start, end))
    sizes = per_axis(lambda a: fast_part(full, f"{a}_u", start, end) / rms(window(full, f"{a}_u", start, end)))
    alike = [axis for axis, value in errors.items() if value < 0.1]
    waving = [axis for axis, value in waves.items() if value > 2.0]
    return [
        Claim(
            'before 20 s "both tracking errors\' behavior [...] is very similar"',
            f"rms of e_full - e_simplified over rms of e_simplified, {start:g} to {end:g} s; alike below 0.1",
            text(errors),
            verdict(alike),
        ),
        Claim(
            '"except for a residual oscillation in the DSSC control signal" of the full model',
            f"high-frequency rms of u, full over simplified, {start:g} to {end:g} s; oscillation above 2",
            f"{text(waves)} (as a share of the rms of u: {text(sizes)})",
            verdict(waving),
        ),
    ]


def verdict(axes: list[str], nearest: tuple[str, ...] = AXES) -> str:
    """Holds, holds on some axes, or does not hold."""
    if set(axes) >= set(nearest):
        return "holds"
    return f"in part: on {', '.join(axes)} only" if axes else "does not hold"


def functions_rise(full: xr.Dataset, simple: xr.Dataset, at: float = SECONDS, before: float = 5.0) -> Claim:
    """Fig. 4."""
    found = {
        f"{model} {name}": per_axis(lambda a, run=run, name=name: rise(run, f"{a}_{name}", at, before))
        for model, run in (("full", full), ("simplified", simple))
        for name in ("k_o", "tau_m")
    }
    risen = [axis for axis in AXES if all(values[axis] > 1.05 for values in found.values())]
    measured = "; ".join(f"{name}: {text(values, '.3f')}" for name, values in found.items())
    return Claim(
        'k_o and tau_m: "both increase when the disturbance acts after t = 20s"',
        f"mean over the 10 s after over the mean of the {before:g} s before; rises above 1.05",
        measured,
        verdict(risen),
    )


def oscillation(runs: Runs, start: float = SECONDS) -> list[Claim]:
    """Fig. 5: what the STA does."""
    share = per_axis(lambda a: fast_part(runs["STA clipped"], f"{a}_u", start) / RHO[a])
    horizontal = 0.5 * (share["x"] + share["y"])
    plain = "does not hold as an oscillation: the vehicle is lost" if lost(runs["STA"]) else "see the next row"
    return [
        Claim(
            'x, y, psi: "kappa2 = 100 provokes significant oscillations" of the STA',
            "how the unlimited STA's run ends",
            lost(runs["STA"]) or "flies to the end",
            plain,
        ),
        Claim(
            'z: "this effect is attenuated"',
            "high-frequency rms of u after 20 s over rho, STA clipped to rho: z against the mean of x and y",
            f"{share['z']:.2g} against {horizontal:.2g}",
            "holds" if share["z"] < 0.5 * horizontal else "does not hold",
        ),
    ]


def advantage(runs: Runs, reading: str, start: float = SECONDS) -> list[Claim]:
    """Fig. 5: DSSC beside the STA, for a reading of kappa_m."""
    fast = {name: per_axis(lambda a, run=run: fast_part(run, f"{a}_u", start)) for name, run in runs.items()}
    ratio = {axis: fast["STA clipped"][axis] / fast["DSSC"][axis] for axis in AXES}
    share = {axis: fast["DSSC"][axis] / RHO[axis] for axis in AXES}
    return [
        Claim(
            f'"when compared with the DSSC equivalent implementation": {reading}',
            "high-frequency rms of u after 20 s, STA clipped to rho over DSSC; more in x, y, psi above 2",
            text(ratio),
            verdict([axis for axis in ("x", "y", "psi") if ratio[axis] > 2.0], ("x", "y", "psi")),
        ),
        Claim(
            f"DSSC does not oscillate (Fig. 5): {reading}",
            "high-frequency rms of u after 20 s over rho; calm below 0.1 (a square wave between +-rho has about 1)",
            text(share),
            verdict([axis for axis in AXES if share[axis] < 0.1]),
        ),
        Claim(
            f'the advantage is robustness "w.r.t. unmodelled dynamics": {reading}',
            "how DSSC's run ends with rho = 100 in place of the printed bound, all else kept",
            lost(runs["DSSC wide"]) or text(fast["DSSC wide"]),
            "does not hold: the bound rho does it" if lost(runs["DSSC wide"]) else "holds",
        ),
    ]


def alike(runs: Runs, kappa2: float, note: str = "", start: float = SECONDS) -> Claim:
    """The curves that are not shown."""
    commands = per_axis(lambda a: gap(runs["DSSC"], runs["STA"], f"{a}_u", start))
    errors = per_axis(lambda a: gap(runs["DSSC"], runs["STA"], f"{a}_e", start))
    near = [axis for axis in AXES if commands[axis] < 0.2 and errors[axis] < 0.2]
    return Claim(
        f'"for small values of kappa2, both controllers have similar behavior": kappa2 = {kappa2:g}{note}',
        "rms of DSSC's signal - STA's over rms of STA's after 20 s, of u and of e; alike below 0.2",
        f"u: {text(commands)}; e: {text(errors)}",
        verdict(near),
    )


def efforts(flights: list[Runs], label: str, start: float = SECONDS) -> Claim:
    """Section V-C."""
    axes = ("x", "y", "z")
    together = per_axis(
        lambda a: float(np.median([correlation(r["DSSC"], r["STA"], f"{a}_u", start) for r in flights])), axes
    )
    apart = per_axis(lambda a: float(np.median([gap(r["DSSC"], r["STA"], f"{a}_u", start) for r in flights])), axes)
    near = [axis for axis in axes if together[axis] > 0.9 and apart[axis] < 0.3]
    return Claim(
        f'field: "control efforts are very similar" ({label})',
        f"u of DSSC and STA on x, y, z after {start:g} s, medians of {len(flights)} winds: correlation, rms of the "
        "difference over rms of STA's; similar above 0.9 and below 0.3",
        f"correlation {text(together)}; difference {text(apart)}",
        verdict(near, axes),
    )
