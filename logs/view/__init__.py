"""3-D views in Rerun."""
