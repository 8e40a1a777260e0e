"""Starts and supervises the processes of one flight, and prints its result."""
