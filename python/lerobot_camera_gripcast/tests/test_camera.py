"""The camera against a daemon on the virtual rig."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
from lerobot.cameras.configs import ColorMode
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from conftest import Daemon
from lerobot_camera_gripcast import GripcastCamera, GripcastCameraConfig
from lerobot_camera_gripcast.camera_gripcast import shear_image

# The machine may be busy.
PATIENT_MS = 10_000.0


def camera(**settings: Any) -> GripcastCamera:
    return GripcastCamera(GripcastCameraConfig(max_age_ms=PATIENT_MS, **settings))


def test_cameras_of_the_daemon_are_found(daemon: Daemon) -> None:
    with camera():
        found = GripcastCamera.find_cameras()
    assert [each["id"] for each in found] == ["left", "right", "rgb", "depth"]
    assert found[0]["images"] == ["raw", "difference", "shear"] and found[2]["images"] == ["raw"]
    assert found[0]["default_stream_profile"] == {"width": 320, "height": 240, "fps": 25.0}
    assert found[0]["url"] == daemon.url


def test_images_come_once_in_the_order_of_their_driver_times(daemon: Daemon) -> None:
    gel = camera(role="left")
    gel.connect()
    times = []
    for _ in range(3):
        image = gel.async_read(PATIENT_MS)
        assert image.shape == (240, 320, 3) and image.dtype == np.uint8 and image.std() > 1
        times.append(gel.driver_time_ns)
    gel.read()
    times.append(gel.driver_time_ns)
    assert times == sorted(set(times))
    # The daemon runs on this machine: its clock is this one.
    frame = gel.read_frame(PATIENT_MS)
    assert abs(time.monotonic_ns() - frame.driver_time_ns - 1e6 * frame.age_ms) < 5e9
    assert gel.read_latest(PATIENT_MS).shape == (240, 320, 3)
    with pytest.raises(DeviceAlreadyConnectedError):
        gel.connect()
    gel.disconnect()
    assert not gel.is_connected
    for call in (gel.read, gel.async_read, gel.read_latest, gel.disconnect):
        with pytest.raises(DeviceNotConnectedError):
            call()


def test_bgr_is_rgb_reversed(daemon: Daemon) -> None:
    with camera() as gel:
        rgb = gel.read_frame(PATIENT_MS).image
        gel.config.color_mode = ColorMode.BGR
        bgr = gel.read_latest(PATIENT_MS)
        # The means of two images of the untouched gel are nearly equal; those of its colours are not.
        means = [image.reshape(-1, 3).mean(axis=0) for image in (rgb, bgr[:, :, ::-1])]
        assert np.abs(means[0] - means[1]).max() < 1 < np.abs(means[0] - means[0][::-1]).max()


def test_difference_and_shear_need_an_initial_frame_and_show_the_contact(daemon: Daemon) -> None:
    for image in ("difference", "shear"):
        with pytest.raises(ConnectionError, match="no initial frame.*save one with the gripper open"):
            camera(image=image).connect()
    daemon.trigger()
    with camera(image="difference") as difference, camera(image="shear") as shear:
        # The hand closes now.
        changed = 0.0
        for _ in range(200):
            changed = max(changed, float(np.abs(difference.async_read(PATIENT_MS).astype(float) - 128).max()))
            frame = shear.read_frame(PATIENT_MS)
            assert frame.markers is not None and frame.markers.shape[2] == 5
            moved = float(np.nanmax(np.abs(frame.markers[:, :, 2:4])))
            if changed > 40 and moved > 1:
                break
        assert changed > 40 and moved > 1
        assert frame.image.shape == (240, 320, 3)
        assert frame.markers.dtype == np.float32


def test_shear_image_states_displacement_and_confidence() -> None:
    markers = np.zeros((2, 2, 5), np.float32)
    markers[0, 0] = (10, 10, 5, -20, 1)
    markers[0, 1] = np.nan
    markers[1, 0] = (10, 30, 9, 9, 0)
    markers[1, 1] = (30, 30, 0, 0, 0.5)
    image = shear_image(markers, m_per_px=1e-4, range_mm=1.0, size=(4, 6))
    assert image.shape == (6, 4, 3)
    assert image[0, 0].tolist() == [192, 1, 255]
    assert image[2, 3].tolist() == [128, 128, 0]
    assert image[3, 0].tolist() == [128, 128, 0]
    assert image[5, 3].tolist() == [128, 128, 128]


def test_missing_daemon_is_named_with_its_address() -> None:
    with pytest.raises(ConnectionError, match="127.0.0.1:9: no gripcast daemon listens there; start it"):
        GripcastCamera(GripcastCameraConfig(url="http://127.0.0.1:9")).connect()


def test_missing_role_is_named_with_those_that_exist(daemon: Daemon) -> None:
    with pytest.raises(ConnectionError, match="no camera external; it has left, right, rgb, depth"):
        camera(role="external").connect()


def test_unplugged_camera_is_named_and_comes_back(daemon: Daemon) -> None:
    with camera() as gel:
        daemon.unplug("left")
        with pytest.raises(TimeoutError, match="no new frame within 2000 ms: .*the camera is (unplugged|silent)"):
            for _ in range(100):
                gel.async_read(timeout_ms=2000)
        with pytest.raises(TimeoutError, match="too old: .* at most 1 ms"):
            gel.read_latest(max_age_ms=1)
        daemon.unplug()
        assert gel.async_read(timeout_ms=20_000).shape == (240, 320, 3)


def test_ended_daemon_is_reported_by_the_next_read(daemon: Daemon) -> None:
    with camera() as gel:
        daemon.stop()
        with pytest.raises(TimeoutError, match="no gripcast daemon listens there|the connection failed"):
            for _ in range(3):
                gel.async_read(timeout_ms=2000)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"role": "thumb"}, "`role` is expected to be one of left, right"),
        ({"image": "depth"}, "`image` is expected to be one of raw, difference, shear"),
        ({"role": "rgb", "image": "shear"}, "`image: shear` is for the gels"),
        ({"width": 640}, "`width` is 320 px"),
        ({"max_age_ms": 0}, "`max_age_ms` must be above 0"),
    ],
)
def test_invalid_settings_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        GripcastCameraConfig(**settings)
