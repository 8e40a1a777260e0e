"""Companion computer's side of the link to a vehicle."""
