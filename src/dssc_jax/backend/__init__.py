"""Code that depends on JAX internals: compiler settings, program rewriting, kernels."""
