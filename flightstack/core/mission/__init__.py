"""Phases of a flight, the reasons for their transitions, and the command of each phase."""
