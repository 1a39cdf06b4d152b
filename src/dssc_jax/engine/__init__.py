"""Draws by the thousand: sampling, layout, batches, and evaluation at given values."""
