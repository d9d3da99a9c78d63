"""Environments for Gymnasium."""

from __future__ import annotations

import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import SyncVectorEnv

import gripcast as gc
from gripcast.gym import GraspEnv, GraspVectorEnv


def test_environment_passes_the_checks_of_gymnasium() -> None:
    env = gymnasium.make("gripcast/Grasp-v0", max_grasps=3, render_mode="rgb_array")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=False)
    env.reset(seed=1)
    image = env.render()
    assert isinstance(image, np.ndarray) and image.shape == (240, 320, 3) and image.dtype == np.uint8


def test_batch_is_the_same_as_single_environments() -> None:
    batch = GraspVectorEnv(3, max_grasps=2)
    single = SyncVectorEnv([lambda: GraspEnv(max_grasps=2)] * 3)
    np.testing.assert_array_equal(batch.reset(seed=3)[0], single.reset(seed=3)[0])
    random = np.random.default_rng(0)
    ended = 0
    for _ in range(4):
        actions = random.uniform(-1, 1, (3, 2)).astype(np.float32)
        found, expected = batch.step(actions), single.step(actions)
        for mine, theirs in zip(found[:4], expected[:4]):
            np.testing.assert_array_equal(mine, theirs)
        ended += int((found[2] | found[3]).sum())
    assert ended > 0


def test_grasp_in_the_middle_holds() -> None:
    env = GraspEnv(max_grasps=4, mass_kg=(0.2, 0.2), friction=(0.6, 0.6), length_m=(0.14, 0.14))
    first, info = env.reset(seed=5)
    observation, reward, terminated, truncated = first, 0.0, False, False
    for _ in range(4):
        shift = np.clip(-info["offset_m"] / 0.04, -1, 1)
        observation, reward, terminated, truncated, info = env.step(np.array([shift, 0.5], dtype=np.float32))
        if terminated:
            break
    assert terminated and not truncated and info["holds"] and reward > 0.6
    # The nearer to the middle, the less torque.
    assert abs(observation[6:8]).max() < 0.5 * abs(first[6:8]).max()


def test_torque_says_on_which_side_the_middle_is() -> None:
    env = GraspEnv(max_grasps=4)
    for seed in range(4):
        observation, info = env.reset(seed=seed)
        assert np.sign(observation[7] - observation[6]) == np.sign(info["offset_m"])


def test_wrong_use_is_explained() -> None:
    for call in (
        lambda: GraspEnv(max_grasps=0),
        lambda: GraspEnv(mass_kg=(0.3, 0.2)),
        lambda: GraspEnv(render_mode="human"),
        lambda: GraspEnv().step(np.zeros(2, np.float32)),
        lambda: GraspVectorEnv(0),
        lambda: GraspVectorEnv(1).step(np.zeros((1, 2), np.float32)),
    ):
        with pytest.raises(gc.UsageError):
            call()


def test_package_works_without_gymnasium() -> None:
    code = """
import sys
sys.modules["gymnasium"] = None
import gripcast
try:
    import gripcast.gym
except ImportError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "pip install 'gripcast[gym]'" in done.stdout
