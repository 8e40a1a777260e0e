"""Verbs of flight logs."""
