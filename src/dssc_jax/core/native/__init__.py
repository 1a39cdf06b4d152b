"""Controllers in C: shared objects that were built for the kind ``library``."""
