"""How wrong the laws may be before too many draws fail."""
