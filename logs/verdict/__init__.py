"""Judges a landing."""
