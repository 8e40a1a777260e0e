"""The MAVLink side of the simulated autopilot."""
