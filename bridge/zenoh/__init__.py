"""Zenoh sessions, alarms, attachments."""
