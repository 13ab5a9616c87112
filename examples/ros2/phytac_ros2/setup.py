"""Package of ament_python: a launch file and a configuration of RViz."""

from setuptools import setup

NAME = "phytac_ros2"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/sensor.launch.py"]),
        (f"share/{NAME}/rviz", ["rviz/sensor.rviz"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="you",
    maintainer_email="you@example.com",
    description="Starts the force stream of a PhyTac sensor and shows it in RViz.",
    license="MIT",
)
