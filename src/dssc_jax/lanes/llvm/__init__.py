"""LLVM: the text of a program, its compilation, and calls of its machine code."""
