"""Injected faults and their effects."""
