"""Every wire: MAVLink, Zenoh, ROS 2 formats, and the only place with NED frames."""
