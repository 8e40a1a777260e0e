"""The vehicle's side of MAVLink: what a program needs that other programs shall take for an autopilot."""
