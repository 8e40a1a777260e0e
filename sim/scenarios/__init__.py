"""Scenarios of one or several vehicles, one TOML file each."""
