"""Starts and supervises the processes of one flight, and tells its result."""
