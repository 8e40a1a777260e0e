"""Verbs that fly, and those of the processes of a flight."""
