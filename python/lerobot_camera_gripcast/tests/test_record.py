"""`lerobot-record` with the cameras: what LeRobotDataset reads back is what the cameras served."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from lerobot import __version__ as lerobot_version
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from conftest import Daemon
from lerobot_camera_gripcast import GripcastCamera, GripcastCameraConfig

CAMERAS = {
    "left": {"type": "gripcast", "role": "left"},
    "right": {"type": "gripcast", "role": "right", "image": "difference"},
    "shear": {"type": "gripcast", "role": "left", "image": "shear"},
}


# LeRobot 0.4 leaves images out that it does not store as video, which is lossy.
IS_LOSSLESS = not lerobot_version.startswith("0.4.")
MAX_VIDEO_ERROR = 4.0


def test_recorded_images_are_those_that_were_served(daemon: Daemon, tmp_path: Path) -> None:
    with GripcastCamera(GripcastCameraConfig(max_age_ms=10_000)):
        daemon.trigger()
    served, root = tmp_path / "served", tmp_path / "episode"
    served.mkdir()
    cameras = {name: {"max_age_ms": 10_000, **settings} for name, settings in CAMERAS.items()}
    command = [
        sys.executable, "-m", "lerobot.scripts.lerobot_record",
        "--robot.discover_packages_path=gripcast_mock_gripper", "--robot.type=gripcast_mock_gripper",
        "--teleop.type=gripcast_mock_hand", f"--robot.cameras={json.dumps(cameras)}",
        "--dataset.repo_id=gripcast/mugs", f"--dataset.root={root}", "--dataset.single_task=grasp the mug",
        "--dataset.num_episodes=1", "--dataset.episode_time_s=2", "--dataset.fps=5",
        # Lossless: PNG in place of lossy video.
        f"--dataset.video={str(not IS_LOSSLESS).lower()}", "--dataset.push_to_hub=false", "--play_sounds=false",
    ]  # fmt: skip
    environment = os.environ | {
        "PYTHONPATH": str(Path(__file__).parent),
        "GRIPCAST_SERVED": str(served),
        "HF_LEROBOT_HOME": str(tmp_path / "home"),
        "HF_HUB_OFFLINE": "1",
    }
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    dataset = LeRobotDataset("gripcast/mugs", root=root, video_backend="pyav")
    assert dataset.num_episodes == 1
    files = sorted(served.glob("*.npz"))
    assert len(dataset) == len(files) > 3
    for name in CAMERAS:
        assert dataset.features[f"observation.images.{name}"]["dtype"] == ("image" if IS_LOSSLESS else "video")
    for index, file in enumerate(files):
        item = dataset[index]
        assert item["action"].item() == 0.5 * (index + 1)
        with np.load(file) as images:
            for name in CAMERAS:
                read = item[f"observation.images.{name}"].permute(1, 2, 0).numpy()
                where = f"{name} of frame {index}"
                if IS_LOSSLESS:
                    assert np.array_equal(np.rint(read * 255).astype(np.uint8), images[name]), where
                else:
                    assert np.abs(read * 255.0 - images[name]).mean() < MAX_VIDEO_ERROR, where
