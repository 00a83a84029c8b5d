"""Install jpap_ros as an ament_python package."""

from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = "jpap_ros"


def shared(folder: str) -> list[tuple[str, list[str]]]:
    """Every file below `folder`, to be installed under the same path in the package's share."""
    files: dict[str, list[str]] = {}
    for path in sorted(Path(folder).rglob("*")):
        if path.is_file():
            files.setdefault(f"share/{PACKAGE}/{path.parent}", []).append(str(path))
    return list(files.items())


setup(
    name=PACKAGE,
    version="0.1.0",
    description="Live UAV fleet deployment: planner, MAVLink bridge and simulated vehicles for ROS 2",
    maintainer="jpap_ros maintainers",
    maintainer_email="maintainers@jpap-ros.example",
    license="Apache-2.0",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={PACKAGE: ["py.typed", "dashboard/static/**/*", "report/*.j2"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        *shared("config"),
        *shared("launch"),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            f"planner = {PACKAGE}.nodes.planner:main",
            f"bridge = {PACKAGE}.nodes.bridge:main",
            f"sim = {PACKAGE}.nodes.sim:main",
            f"markers = {PACKAGE}.nodes.markers:main",
            f"dashboard = {PACKAGE}.nodes.dashboard:main",
            f"recorder = {PACKAGE}.nodes.recorder:main",
            f"replay = {PACKAGE}.nodes.replay:main",
        ],
    },
)
