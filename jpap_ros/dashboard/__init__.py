"""The operator's live page: what it shows as JSON, and the web server that serves it; no ROS."""
