"""Links, vehicles, commands, autopilot personalities, geodesy and signing. Knows no ROS."""
