"""The front door: a function of one lane, compiled for batches of lanes."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.lanes.lanes import CompiledLanes
from dssc_jax.lanes.llvm import machine


def compile(function: Callable[..., Any], *example: Any, strict: bool = False) -> Callable[..., Any]:
    """Compile a function of scalars for many lanes, as ``jax.jit(jax.vmap(function))`` would.

    The lanes of a batch run on all cores, several in each vector register. The function may use ``jax.lax``'s
    elementwise operations, loops, branches, random numbers, and small arrays within a lane.

    Args:
        function: A pure function of trees of scalars; its results are scalars, and arrays that a ``scan`` records.
        example: An example of each argument: trees of numbers or of ``jax.ShapeDtypeStruct``. Only their types count,
            which are JAX's: 64 bits under ``jax.enable_x64``, 32 bits otherwise.
        strict: Never contract a product and a sum into one operation, so that the bits are the same on every machine.

    Returns:
        The compiled function. Its arguments are trees like the examples, with a column of shape (n,) in place of each
        scalar. Its results are NumPy arrays of shape (n, ...).

    Raises:
        Unsupported: An operation has no translation; the message names it and its place in the source.
        TypeError: An example holds something other than scalar numbers.

    Example:
        >>> import numpy as np
        >>> from dssc_jax import lanes
        >>> def population(rate, start):
        ...     return jax.lax.fori_loop(0, 100, lambda year, x: rate * x * (1.0 - x), start)
        >>> import jax
        >>> batch = lanes.compile(population, 1.0, 1.0)
        >>> batch(np.array([0.5, 2.0]), np.array([0.3, 0.3])).round(3).tolist()
        [0.0, 0.5]
    """
    types = tuple(jax.tree.map(scalar_type, argument) for argument in example)
    structure = jax.tree.structure(types)
    compiled = CompiledLanes(function, *types, strict=strict)
    threads = machine.usable_cores()

    def batch(*arguments: Any) -> Any:
        """Run all lanes and return their results; an argument is a tree of columns of shape (n,), one element a lane.

        Raises:
            TypeError: The arguments are not trees like the examples.
            ValueError: The columns differ in length, or have more than one axis.
        """
        columns = jax.tree.leaves(arguments)
        if jax.tree.structure(arguments) != structure:
            raise TypeError(f"the arguments must have the structure {structure}, got {jax.tree.structure(arguments)}")
        shapes = {np.shape(column) for column in columns}
        have_one_length = len(shapes) == 1 and all(len(shape) == 1 for shape in shapes)
        if not have_one_length:
            raise ValueError(f"the columns must have one shape (n,), got {sorted(shapes)}")
        wait_for_results = compiled.start(arguments, len(columns[0]), threads)
        return wait_for_results()

    return batch


def scalar_type(example: Any) -> jax.ShapeDtypeStruct:
    """Return the shape () and the dtype of an example, in the form with which JAX traces a function.

    The dtype is limited to JAX's present precision: without 64 bits, float64 becomes float32.

    Raises:
        TypeError: The example is an array.
    """
    if np.shape(example) != ():
        raise TypeError(f"an example must be a tree of scalars, got an array of shape {np.shape(example)}")
    dtype = example.dtype if hasattr(example, "dtype") else jnp.result_type(example)
    return jax.ShapeDtypeStruct((), jax.dtypes.canonicalize_dtype(dtype))
