"""What touches the inside of JAX: compiler settings, rewritten programs, kernels."""
