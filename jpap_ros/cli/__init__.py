"""The command line: a deployment without ROS."""
