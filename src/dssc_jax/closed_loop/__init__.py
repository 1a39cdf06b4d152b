"""Simulation of one draw of the closed loop: samples, time loops, metrics, requirements."""
