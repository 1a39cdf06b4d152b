"""Errors of the laws: how wrong they may be before too many draws fail, and laws whose arguments are ranges."""
