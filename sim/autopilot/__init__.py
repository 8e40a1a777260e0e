"""MAVLink autopilot of the simulated vehicle; ``autopilot`` assembles its parts."""
