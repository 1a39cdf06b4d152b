"""The foundation of the package: quantities, signals, contracts of models, errors, and numerics."""
