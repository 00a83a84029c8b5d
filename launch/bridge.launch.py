"""Start the bridge: goals to the aircraft over MAVLink, their poses and states back."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments and start the node."""
    config = PathJoinSubstitution([FindPackageShare("jpap_ros"), "config"])
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "fleet_file",
                default_value=PathJoinSubstitution([config, "fleet_example.yaml"]),
                description="Path of the fleet file, the same for planner, bridge and sim",
            ),
            DeclareLaunchArgument(
                "simulated_clock",
                default_value="false",
                description="Whether all aircraft are simulated, and may fly faster than the clock: true or false",
            ),
            DeclareLaunchArgument("namespace", default_value="", description="ROS namespace of the node"),
            DeclareLaunchArgument(
                "params_file",
                default_value=PathJoinSubstitution([config, "params.yaml"]),
                description="Path of the parameters file; fleet_file, simulated_clock and use_sim_time override it",
            ),
            DeclareLaunchArgument(
                "use_sim_time", default_value="false", description="Take the time from /clock: true or false"
            ),
            DeclareLaunchArgument(
                "log_level", default_value="info", description="Least level that is logged: debug, info, warn, error"
            ),
            Node(
                package="jpap_ros",
                executable="bridge",
                name="bridge",
                namespace=LaunchConfiguration("namespace"),
                parameters=[
                    LaunchConfiguration("params_file"),
                    {
                        "fleet_file": ParameterValue(LaunchConfiguration("fleet_file"), value_type=str),
                        "simulated_clock": ParameterValue(LaunchConfiguration("simulated_clock"), value_type=bool),
                        "use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool),
                    },
                ],
                ros_arguments=["--log-level", LaunchConfiguration("log_level")],
                output="screen",
                emulate_tty=True,
            ),
        ]
    )
