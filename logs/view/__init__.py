"""Shows flights as 3-D scenes in Rerun."""
