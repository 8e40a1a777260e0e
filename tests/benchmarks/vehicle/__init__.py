"""Compares the simulated vehicle with published numbers and linear analysis."""
