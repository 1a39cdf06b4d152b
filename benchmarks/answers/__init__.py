"""How many simulations and seconds an answer takes, here and with other tools for uncertainty: ``make answers``."""
