"""Safety filters (the paper's and the robust one), and the tracking of velocity commands."""
