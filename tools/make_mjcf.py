"""Write the shipped MJCF of the KR90, drives under servo, in the milling posture: ``python tools/make_mjcf.py``."""

from pathlib import Path

from twin.robot.description import SHIPPED, load_robot
from twin.robot.mechanism import assemble
from twin.robot.mjcf import build_spec, save_mjcf


def make(path: Path = SHIPPED / "kr90.xml") -> None:
    """Write the model; the meshes are referenced relative to it."""
    robot = load_robot("kr90")
    save_mjcf(
        path, build_spec(assemble(robot, robot.angles([0, 70, -100]), brakes="off", drives="servo")), copy_meshes=False
    )


if __name__ == "__main__":
    make()
