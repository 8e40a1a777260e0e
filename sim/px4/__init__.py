"""PX4 on the simulated vehicle: the simulator side of PX4 software in the loop."""
