"""The verifier of the whole vehicle's theorem. It shares no code with the search."""
