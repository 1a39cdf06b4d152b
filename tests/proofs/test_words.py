"""A statement of proof is in the units of the study."""

import dssc_jax as dj
from dssc_jax.core.units import ChannelUnits
from dssc_jax.proofs.coverage import problem_of
from dssc_jax.proofs.prove import Proved
from dssc_jax.proofs.search.box_search import Proof


def test_the_statement_is_in_the_units_of_the_study():
    study = dj.Study.load("design_map").without_sweep()
    proof = Proof.__new__(Proof)  # any: the statement only counts them
    text = Proved(problem_of(study), [proof], [], 0.1, 0.2, 1.0, ChannelUnits("rad", "V")).statement()
    assert "never exceeds |e| = 0.2 rad and ends within |e| <= 0.1 rad." in text
    assert "|d| <= 0.1 V and |d'| <= 0.10472 V/s" in text
    assert "k_p in [0.9, 1.1] rad/(s^2 V)" in text
