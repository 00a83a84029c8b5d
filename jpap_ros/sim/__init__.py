"""Simulated multirotors that speak MAVLink 2. Knows no ROS."""
