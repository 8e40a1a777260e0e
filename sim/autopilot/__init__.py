"""The simulated vehicle's MAVLink autopilot; ``server`` assembles its parts."""
