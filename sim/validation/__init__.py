"""Compares the simulator with recorded flights of a real vehicle: plant, closed loop, own-state errors."""
