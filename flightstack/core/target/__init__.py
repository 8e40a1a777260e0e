"""What is estimated: the target, whether the own state can be true, the thrust reserve."""
