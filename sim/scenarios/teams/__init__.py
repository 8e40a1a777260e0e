"""Scenarios of several vehicles, one TOML file each."""
