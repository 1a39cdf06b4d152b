"""The search for bounds of a whole vehicle's signals that imply themselves."""
