"""The safety filters: the paper's and the robust one, with the tracking of the velocity loop."""
