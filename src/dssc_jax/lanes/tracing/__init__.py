"""From the trace of a lane to its typed program."""
