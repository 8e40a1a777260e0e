"""Verbs for real vehicles and other autopilots."""
