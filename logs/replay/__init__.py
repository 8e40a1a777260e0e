"""Replays the inputs of a log through the controller, and compares the outputs."""
