"""(V2) The functions of a channel within a region: their distances from straight lines, and their largest gains.

The straight lines k_1 sigma, k_2 sigma and k_3 sigma replace phi_1, phi_2 and phi_3 = sigma/(k_n tau_m), which the
search calls n. The differences are omega_u = phi_1 + phi_3 - (k_1 + k_3) sigma and omega_q = phi_2 - k_2 sigma. The
latter is written as omega_q = s_q omega_u + omega_r, with the share s_q.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple, cast

from flint import arb

from dssc_jax.proofs.verifier.balls import Balls, Rejected, maximum, minimum_bound
from dssc_jax.proofs.verifier.certificate import Problem
from dssc_jax.proofs.verifier.function_distances import StraightLines, function_distances
from dssc_jax.proofs.verifier.gain_enclosures import enclosed_gains
from dssc_jax.proofs.verifier.vehicle.certificate import MiddleProof, VehicleProblem
from dssc_jax.proofs.verifier.vehicle.premises import with_premise

DISTANCE_ROOM = 1e-3
"""Largest excess of a distance's bound over the distances at points, as a share of them."""


class Deviations(NamedTuple):
    """Upper bounds of the distances of a channel's functions from straight lines, over a region of |sigma| on one axis.

    Args:
        phi_1_distance: D_1 of docs/vehicle_proofs.md, bound of |phi_1 - k_1 sigma|.
        omega_r_distance: D_2, bound of |omega_r|.
        omega_u_distance: D_b, bound of |omega_u|.
        phi_1_ratio: d_1, bound of |phi_1 - k_1 sigma|/|sigma|.
        omega_r_ratio: d_2, bound of |omega_r|/|sigma|.
        omega_u_ratio: d_b, bound of |omega_u|/|sigma|.
        k_p: Largest K_P.
        k_i: Largest K_I [1/s].
        tau_av: Largest tau_av [s].
    """

    phi_1_distance: arb
    omega_r_distance: arb
    omega_u_distance: arb
    phi_1_ratio: arb
    omega_r_ratio: arb
    omega_u_ratio: arb
    k_p: arb
    k_i: arb
    tau_av: arb

    def of_command(self, sigma: arb) -> arb:
        """Bound of |omega_u|, the command's deviation, for |sigma| up to ``sigma``: min(D_b, d_b |sigma|)."""
        return minimum_bound(self.omega_u_distance, self.omega_u_ratio * sigma)

    def of_integral(self, sigma: arb) -> arb:
        """Bound of |omega_r|, the own deviation of the sum q, for |sigma| up to ``sigma``: min(D_2, d_2 |sigma|)."""
        return minimum_bound(self.omega_r_distance, self.omega_r_ratio * sigma)

    def of_start(self, start: str, sigma: arb, sample_time: arb, share: arb) -> arb:
        """Bound of the deviation of q_(-1), the sum before the first sample, from its value with straight lines.

        q_(-1) is 0 for the start ``zero`` and -phi_1(sigma_0) for ``matched``. For ``midpoint`` it is lower by (T_s/2)
        phi_2(sigma_0), so that its deviation contains (T_s/2) omega_q besides.

        Args:
            start: Start of the predictor: ``zero``, ``matched`` or ``midpoint``.
            sigma: Sigma_0, bound of |sigma| at t = 0.
            sample_time: T_s [s].
            share: s_q.
        """
        if start == "zero":
            return arb(0)
        deviation = minimum_bound(self.phi_1_distance, self.phi_1_ratio * sigma)
        if start == "midpoint":
            omega_q = self.of_integral(sigma) + abs(share) * self.of_command(sigma)
            deviation = deviation + sample_time / 2 * omega_q
        return deviation.upper()


def deviations_in_regions(
    problem: VehicleProblem, name: str, proof: MiddleProof, sigmas: Sequence[arb]
) -> list[Deviations]:
    """(V2) The deviations of a channel's functions for |sigma| up to each of several bounds, in the bounds' order.

    The intervals of |sigma| between one bound and the next are enclosed one by one, so that none is enclosed twice.

    Args:
        problem: The certificate's problem.
        name: Name of the channel.
        proof: The channel's proof, with the slopes of the lines and the share s_q.
        sigmas: Bounds of |sigma| [m/s; rad/s in psi], in any order.
    """
    regions: dict[float, Deviations] = {}  # by their bound
    largest = None  # of all pieces so far
    low = 0.0
    for high in sorted({float_above(sigma) for sigma in sigmas}):
        piece = deviations_of(problem, name, proof, high, low)
        largest = piece if largest is None else Deviations(*map(maximum, largest, piece))
        regions[high] = largest
        low = high
    return [regions[float_above(sigma)] for sigma in sigmas]


def deviations_of(
    problem: VehicleProblem, name: str, proof: MiddleProof, sigma: float, sigma_from: float = 0.0
) -> Deviations:
    """(V2) The deviations of a channel's functions from straight lines within a region.

    Args:
        problem: The certificate's problem.
        name: Name of the channel.
        proof: The channel's proof, with the slopes k_1, k_2 and k_3 of the lines and the share s_q.
        sigma: Largest |sigma| [m/s; rad/s in psi].
        sigma_from: Smallest |sigma|.

    Raises:
        Rejected: The functions cannot be enclosed.
    """
    controller = problem["channels"][name]
    k_1, k_2, k_3 = map(arb, proof["slopes"])
    slopes = {"mean": k_1, "k_i": k_2, "k_n": k_3}  # of phi_1, phi_2 and phi_3, by the gains that are their ratios
    lines = StraightLines(slopes, proof["share"])
    loop = cast(
        Problem,  # only the entries that the gains depend on
        {
            "sample_time": problem["sample_time"],
            "l0": controller["l0"],
            "form": "conservative",
            "functions": controller["functions"],
            "nominal": controller["nominal"],
        },
    )
    try:
        distances = function_distances(loop, sigma, e=0.0, lines=lines, room=DISTANCE_ROOM, sigma_from=sigma_from)
        gains = enclosed_gains(loop, sigma, e=0.0, sigma_from=sigma_from)
    except Rejected as rejected:
        raise with_premise(rejected, "V2", f" of {name}") from None
    ratios = Balls({gain: abs(gains[gain] - slope).upper() for gain, slope in slopes.items()})
    omega_u_ratio = (ratios["mean"] + ratios["k_n"]).upper()
    return Deviations(
        phi_1_distance=distances["phi_1"].upper(),
        omega_r_distance=distances["phi_2"].upper(),
        omega_u_distance=distances["both"].upper(),
        phi_1_ratio=ratios["mean"],
        omega_r_ratio=(ratios["k_i"] + abs(arb(proof["share"])) * omega_u_ratio).upper(),
        omega_u_ratio=omega_u_ratio,
        k_p=gains["k_p"].upper(),
        k_i=gains["k_i"].upper(),
        tau_av=gains["tau_av"].upper(),
    )


def float_above(value: arb) -> float:
    """A float64 number above an exact ball: the rounded value of the ball, moved up by one step."""
    return math.nextafter(float(value), math.inf)
