"""Which UAV flies where and how it gets there safely. Knows neither ROS nor MAVLink."""
