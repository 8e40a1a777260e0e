"""Poses of a motion capture to the vehicle; ``process`` is the loop, ``checks`` the core."""
