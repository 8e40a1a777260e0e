"""Schemas of the log, and the encoding of its messages."""
