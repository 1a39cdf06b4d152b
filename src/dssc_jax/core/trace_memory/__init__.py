"""What a trace tells, kept in the user's cache, so that a known program need not be traced again."""
