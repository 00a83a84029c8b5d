"""Quality-of-service profiles of the ROS contract."""

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data

#: A late subscriber gets the newest message.
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)

#: A late planner gets the device reports that it missed.
DEVICES = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)

#: Fast and fresh, losses allowed.
SENSOR_DATA = qos_profile_sensor_data
