"""Schemas of the log, and the coding of its messages."""
