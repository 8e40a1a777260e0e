"""Vehicle side of MAVLink: a server with which a program appears as an autopilot."""
