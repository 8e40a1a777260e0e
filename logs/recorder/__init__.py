"""The flight recorder, its MCAP file, and the topics that it derives for viewers."""
