"""One page about a recorded flight, read from an MCAP file; no ROS graph."""
