"""Configurations of the onboard process that come with the package, by name."""
