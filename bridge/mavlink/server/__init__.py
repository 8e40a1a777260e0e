"""The vehicle's side of MAVLink: a server that lets a program appear as an autopilot."""
