"""Receives target samples as odometry or poses."""
