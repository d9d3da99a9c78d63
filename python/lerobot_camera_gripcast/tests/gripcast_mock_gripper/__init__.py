"""A robot and a teleoperator without hardware: one gripper with cameras.

The robot writes every image that its cameras serve to the folder GRIPCAST_SERVED, as served.
"""

import os
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.cameras import CameraConfig
from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.robots import Robot, RobotConfig
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig


@RobotConfig.register_subclass("gripcast_mock_gripper")
@dataclass(kw_only=True)
class MockGripperConfig(RobotConfig):
    cameras: dict[str, CameraConfig] = field(default_factory=dict)


class MockGripper(Robot):
    config_class = MockGripperConfig
    name = "gripcast_mock_gripper"

    def __init__(self, config: MockGripperConfig) -> None:
        super().__init__(config)
        self.cameras = make_cameras_from_configs(config.cameras)
        self._position = 0.0
        self._served = 0

    @cached_property
    def observation_features(self) -> dict[str, Any]:
        images = {name: (camera.height, camera.width, 3) for name, camera in self.cameras.items()}
        return {"gripper.pos": float, **images}

    @cached_property
    def action_features(self) -> dict[str, Any]:
        return {"gripper.pos": float}

    @property
    def is_connected(self) -> bool:
        return all(camera.is_connected for camera in self.cameras.values())

    def connect(self, calibrate: bool = True) -> None:
        for camera in self.cameras.values():
            camera.connect()

    @property
    def is_calibrated(self) -> bool:
        return True

    def calibrate(self) -> None:
        pass

    def configure(self) -> None:
        pass

    def get_observation(self) -> dict[str, Any]:
        images = {name: camera.async_read(timeout_ms=5000) for name, camera in self.cameras.items()}
        folder = Path(os.environ["GRIPCAST_SERVED"])
        np.savez(folder / f"{self._served:04}.npz", **images)
        self._served += 1
        return {"gripper.pos": self._position, **images}

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        self._position = action["gripper.pos"]
        return action

    def disconnect(self) -> None:
        for camera in self.cameras.values():
            camera.disconnect()


@TeleoperatorConfig.register_subclass("gripcast_mock_hand")
@dataclass(kw_only=True)
class MockHandConfig(TeleoperatorConfig):
    pass


class MockHand(Teleoperator):
    config_class = MockHandConfig
    name = "gripcast_mock_hand"

    def __init__(self, config: MockHandConfig) -> None:
        super().__init__(config)
        self._is_connected = False
        self._position = 0.0

    @cached_property
    def action_features(self) -> dict[str, Any]:
        return {"gripper.pos": float}

    @cached_property
    def feedback_features(self) -> dict[str, Any]:
        return {}

    @property
    def is_connected(self) -> bool:
        return self._is_connected

    def connect(self, calibrate: bool = True) -> None:
        self._is_connected = True

    @property
    def is_calibrated(self) -> bool:
        return True

    def calibrate(self) -> None:
        pass

    def configure(self) -> None:
        pass

    def get_action(self) -> dict[str, Any]:
        self._position += 0.5
        return {"gripper.pos": self._position}

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        pass

    def disconnect(self) -> None:
        self._is_connected = False
