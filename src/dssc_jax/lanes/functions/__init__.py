"""Elementary functions as arithmetic: the same bits on every machine and for every width of vectors."""
