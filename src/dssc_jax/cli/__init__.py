"""The command line: declarations of options, and a module for each command."""
