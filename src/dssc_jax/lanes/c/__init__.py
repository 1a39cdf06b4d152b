"""C as the text of a program, for people and compilers."""
