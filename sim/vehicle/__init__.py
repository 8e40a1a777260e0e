"""The simulated vehicle: physics and firmware in one loop."""
