"""The main job: real device positions to a hovering fleet, as processes on one machine."""
