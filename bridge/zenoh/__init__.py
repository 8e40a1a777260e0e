"""Zenoh sessions, connection alarms, attachments."""
