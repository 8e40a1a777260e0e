"""The software-in-the-loop vehicle, its ground robot and their world."""
