"""The flight recorder and its MCAP writer."""
