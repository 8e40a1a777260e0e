"""Faults that are injected into a simulation, and their effects."""
