"""The terminal view of a running onboard process."""
