"""Processes of the simulator, and a landing in one process."""
