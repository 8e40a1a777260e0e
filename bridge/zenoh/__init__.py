"""Zenoh sessions, connection alarms and attachments."""
