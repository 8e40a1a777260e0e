"""Converts MAVLink frames and messages to and from bytes."""
