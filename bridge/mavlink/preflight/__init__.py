"""Checks a vehicle's parameters before a flight."""
