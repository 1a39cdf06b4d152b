"""Results of a run: the dataset's schema, its files, the result and its summary."""
