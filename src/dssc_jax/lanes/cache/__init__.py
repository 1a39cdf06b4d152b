"""What took long to find, kept in the user's cache directory under a name of all that it follows from."""
