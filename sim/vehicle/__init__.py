"""The simulated vehicle: one loop runs physics and firmware."""
