"""Files of logged flights: tables and ULogs of PX4, their columns, clocks, resets and gaps."""
