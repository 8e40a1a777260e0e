"""Signed MAVLink frames."""
