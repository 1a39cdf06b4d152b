"""Running studies: run, run until a stopping rule, simulate and replay one draw, verify, cluster."""
