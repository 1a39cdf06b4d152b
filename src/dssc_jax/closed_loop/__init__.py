"""One draw of the closed loop: samples, time loops, metrics, requirements."""
