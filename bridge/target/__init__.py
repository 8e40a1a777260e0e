"""Target samples from odometry, poses and transforms on the wire."""
