"""(P6) on single corners: what holds is accepted, and an input that is not certainly zero counts."""

import pytest
from flint import arb, arb_mat

from dssc_jax.proofs.verifier.balls import Rejected, interval_ball
from dssc_jax.proofs.verifier.enclosed_loop import Corner
from dssc_jax.proofs.verifier.invariant_sets import check_invariance
from dssc_jax.proofs.verifier.verdict import ball_precision

STAGE = {"rate": 0.5, "multipliers": [0.5]}
P = arb_mat([[1]])


def check(a, b):
    """P6 of z+ = a z + b w with P = 1, T_s = 1 and lambda = 1/2."""
    with ball_precision():
        check_invariance(arb(1), STAGE, P, [Corner(arb_mat([[a]]), arb_mat([[b]]))], "the corner")


def test_a_set_that_is_invariant_is_accepted():
    check(0.25, 0)
    check(0.25, 0.25)
    check(0.25, interval_ball(0.0, 0.25))


@pytest.mark.parametrize(("a", "b"), [(0.75, 0), (0.25, 2), (0.25, interval_ball(0.0, 2.0)), (interval_ball(0, 1), 0)])
def test_a_set_that_need_not_be_invariant_is_refused(a, b):
    with pytest.raises(Rejected, match="P6: the set is not invariant"):
        check(a, b)
