"""The controller of a study for a flight computer: C with the bits of the analysis, and a bench that checks them."""
