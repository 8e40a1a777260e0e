"""Judges a landing from its log."""
