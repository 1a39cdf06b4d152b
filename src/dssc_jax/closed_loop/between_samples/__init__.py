"""Plant and unmodelled dynamics from one sample to the next, with the commands held."""
