"""Receives target samples as odometry, poses or transforms."""
