"""Links to other programs: MAVLink, Zenoh, ROS 2 formats; the only package that uses NED frames."""
