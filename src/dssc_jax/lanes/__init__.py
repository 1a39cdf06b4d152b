"""How lanes run: translation of JAX's trace, machine code, plain XLA, kernels of a GPU, the cache of programs."""
