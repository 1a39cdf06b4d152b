"""The simulation engine: sampling, layout, batches, and evaluation at given values."""
