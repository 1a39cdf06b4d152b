"""The spectrum of the answer to measurement noise."""
