"""What runs a study: in one piece, until its draws decide, one draw alone, again, or on a cluster."""
