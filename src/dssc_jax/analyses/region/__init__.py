"""The safe region of two numbers."""
