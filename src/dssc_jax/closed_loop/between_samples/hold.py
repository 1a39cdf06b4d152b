"""Plant and unmodelled dynamics between two samples, with the commands held (zero-order hold).

Linear parts advance by their exact solution: linear unmodelled dynamics, and a plant that declares its linear part. Any
other plant is integrated by fixed steps.
"""

from dssc_jax.closed_loop.between_samples.exact_steps import advance_exactly
from dssc_jax.closed_loop.between_samples.fixed_steps import advance_by_steps
from dssc_jax.closed_loop.between_samples.held_parts import Advance, HeldParts, term_count
from dssc_jax.core.contracts import Variation
from dssc_jax.core.integrators import ORDERS, Integrator
from dssc_jax.core.signals import Params


def between_samples(parts: HeldParts, plant: Params, unmodelled: tuple[Params, ...]) -> Advance:
    """Return the function that advances the plant and the unmodelled dynamics of one draw by one sample.

    Call ``between_samples`` before the time loop: matrices that depend on the parameters alone are then computed once
    for a draw.

    Args:
        parts: The models and the clock.
        plant: The plant's parameters.
        unmodelled: Parameters of the unmodelled dynamics of each channel.
    """
    if parts.plant.linear is not None:
        return advance_exactly(parts, parts.plant.linear(plant), plant, unmodelled)
    return advance_by_steps(parts, plant, unmodelled)


def is_exact(parts: HeldParts) -> bool:
    """Whether the loop has an exact solution between the samples, so that the number of substeps does not matter.

    This requires that every signal at the input of the plant's linear part is constant over a sample, and that nothing
    nonlinear is left.
    """
    disturbances_vary = any(variation != Variation.HELD for variation in parts.variations)
    if disturbances_vary:
        return False
    if parts.plant.advance is not None:  # the plant's own solver, whose error counts as a part of the plant
        return all(model.held and model.linear is None for model in parts.unmodelled)
    is_linear = parts.plant.linear is not None and parts.plant.remainder is None
    return is_linear and all(term_count(model) == 1 for model in parts.unmodelled)


def order_between_samples(parts: HeldParts) -> int:
    """Order p of the integration error, which falls as h^p with the substep h.

    The order is the smallest one among the loop's method and the unmodelled dynamics that state an order. It means
    nothing for a loop with an exact solution.
    """
    # a plant with a solver of its own receives a constant input, as by Euler's method
    integrator = Integrator.EULER if parts.plant.advance is not None else parts.integrator
    stated_orders = [model.order for model in parts.unmodelled if model.order is not None]
    return min([ORDERS[integrator], *stated_orders])
