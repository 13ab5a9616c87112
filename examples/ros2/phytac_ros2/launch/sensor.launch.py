"""The sensor's stream as ROS 2 topics, where the sensor is on the robot, and RViz."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

ARGUMENTS = {
    "bundle": (None, "folder of the decoder, such as exports/mine/decoder"),
    "source": ("0", "number of the camera"),
    "phytac": ("phytac", "the program, such as /home/me/phytac/.venv/bin/phytac"),
    "parent": ("tool0", "frame of the robot that carries the sensor"),
    "rviz": ("true", "whether to show the forces"),
}


def generate_launch_description() -> LaunchDescription:
    """Processes to start."""
    given = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    stream = ExecuteProcess(
        cmd=[
            given["phytac"],
            "serve",
            given["bundle"],
            given["source"],
            "--rest-first",
            "30",
            "--ros2",
        ],
        output="screen",
    )
    # Where the sensor sits on the robot: replace by your mount, or by the exported URDF.
    mount = Node(
        package="tf2_ros",
        executable="static_transform_publisher",
        arguments=["--frame-id", given["parent"], "--child-frame-id", "sensor"],
    )
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        arguments=[
            "-d",
            str(Path(get_package_share_directory("phytac_ros2"), "rviz", "sensor.rviz")),
        ],
        condition=IfCondition(given["rviz"]),
    )
    declared = [
        DeclareLaunchArgument(name, default_value=value, description=text)
        for name, (value, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, stream, mount, rviz])
