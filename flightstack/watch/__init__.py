"""Terminal view of a running onboard process."""
