"""Recorded flights of a real vehicle: reading and screening."""
