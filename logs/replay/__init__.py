"""Replays a log through the code that flew, and compares."""
