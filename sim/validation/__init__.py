"""Compares the simulator with recorded flights of a real vehicle: plant, closed loop, state estimate."""
