"""Thin ROS shells round planning, fleet, mavlink and sim: parameters, messages, callbacks."""
