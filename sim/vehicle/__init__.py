"""The simulated vehicle: plant and firmware in one loop."""
