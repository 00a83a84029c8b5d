"""Start everything: planner, bridge, the picture for viewers and, where asked for, simulated aircraft and more."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, ThisLaunchFileDir
from launch_ros.substitutions import FindPackageShare

SHARED = ("fleet_file", "namespace", "params_file", "use_sim_time", "log_level")


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments and include the launch file of each node."""
    config = PathJoinSubstitution([FindPackageShare("jpap_ros"), "config"])
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "fleet_file",
                default_value=PathJoinSubstitution([config, "fleet_example.yaml"]),
                description="Path of the fleet file, the same for planner, bridge and sim",
            ),
            DeclareLaunchArgument(
                "scheme",
                default_value="optimal",
                description="Algorithm that makes the deployment, e.g. optimal or jpap",
            ),
            # Beside real aircraft, simulated ones of the same ids would be taken for them.
            DeclareLaunchArgument("sim", default_value="false", description="Start simulated aircraft: true or false"),
            DeclareLaunchArgument(
                "dashboard", default_value="false", description="Serve the page for the browser: true or false"
            ),
            DeclareLaunchArgument(
                "markers", default_value="true", description="Draw for RViz, Foxglove and others: true or false"
            ),
            DeclareLaunchArgument("record", default_value="false", description="Record the flight: true or false"),
            DeclareLaunchArgument("namespace", default_value="", description="ROS namespace of all nodes"),
            DeclareLaunchArgument(
                "params_file",
                default_value=PathJoinSubstitution([config, "params.yaml"]),
                description="Path of the parameters file; fleet_file, scheme and use_sim_time override it",
            ),
            DeclareLaunchArgument(
                "use_sim_time", default_value="false", description="Take the time from /clock: true or false"
            ),
            DeclareLaunchArgument(
                "log_level", default_value="info", description="Least level that is logged: debug, info, warn, error"
            ),
            _include("planner", (*SHARED, "scheme")),
            _include("bridge", SHARED, simulated_clock="sim"),
            _include("sim", SHARED, condition=IfCondition(LaunchConfiguration("sim"))),
            _include("markers", SHARED, condition=IfCondition(LaunchConfiguration("markers"))),
            _include("dashboard", SHARED, condition=IfCondition(LaunchConfiguration("dashboard"))),
            _include("recorder", SHARED, condition=IfCondition(LaunchConfiguration("record"))),
        ]
    )


def _include(
    node: str, arguments: tuple[str, ...], condition: IfCondition | None = None, **renamed: str
) -> IncludeLaunchDescription:
    handed_on = {name: name for name in arguments} | renamed
    return IncludeLaunchDescription(
        PythonLaunchDescriptionSource(PathJoinSubstitution([ThisLaunchFileDir(), f"{node}.launch.py"])),
        launch_arguments=[(theirs, LaunchConfiguration(ours)) for theirs, ours in handed_on.items()],
        condition=condition,
    )
