"""The options of every command, one frozen dataclass each: names, types, defaults and help.

A class's docstring is its command's help, and its fields are the arguments and options. These modules import nothing
that computes, so that help is fast.
"""
