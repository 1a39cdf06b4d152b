"""The controller of a study for a flight computer: C code with the analysis's own bits, and a bench that checks them."""
