"""Search for certificates, in floating point: semidefinite programs and bounds that imply themselves."""
