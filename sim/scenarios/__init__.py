"""Scenarios of one vehicle, one TOML file each."""
