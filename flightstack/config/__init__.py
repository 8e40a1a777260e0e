"""Packaged configurations of the onboard process, by name."""
