"""Reads a log into arrays."""
