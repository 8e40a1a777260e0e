"""The MAVLink autopilot that other programs see; ``server`` puts its parts together."""
