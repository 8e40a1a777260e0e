"""A companion computer's side of the link to a vehicle."""
