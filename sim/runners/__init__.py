"""Processes of the simulator, and landings that run in one process."""
