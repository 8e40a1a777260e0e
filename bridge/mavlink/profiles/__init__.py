"""Differences between autopilots, as tables."""
