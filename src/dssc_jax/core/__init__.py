"""What everything stands on: quantities, signals, contracts of models, errors, and numerics."""
