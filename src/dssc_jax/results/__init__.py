"""What a run leaves: the dataset's schema, its files, the result and its summary."""
