"""Frames and messages of MAVLink, to and from bytes."""
