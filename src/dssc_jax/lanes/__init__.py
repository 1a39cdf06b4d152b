"""How lanes run: translation of JAX's trace, machine code, plain XLA, the cache of programs."""
