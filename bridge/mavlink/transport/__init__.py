"""MAVLink transports: UDP, TCP and serial lines."""
