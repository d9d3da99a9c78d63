"""Cameras of a running gripcast daemon for LeRobot.

`type: gripcast` in a robot's `cameras` is a GelSight Mini's image, its difference to the untouched gel,
or the shear of its gel markers. LeRobot imports this package by its name.
"""

from .camera_gripcast import GripcastCamera, TactileFrame
from .config_gripcast import GripcastCameraConfig

__all__ = ["GripcastCamera", "GripcastCameraConfig", "TactileFrame"]
