"""A camera of a gripcast daemon."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from lerobot.cameras.camera import Camera
from lerobot.cameras.configs import ColorMode
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from ._daemon import Daemon, DaemonError, Served, state_text
from .config_gripcast import HEIGHT, IMAGES, WIDTH, GripcastCameraConfig, default_url

# Longest wait for the first frame, and of `read` for the next, s.
_FIRST_S = 5.0
# Wait after a failed request, s.
_RETRY_S = 0.2


@dataclass(frozen=True, eq=False)
class TactileFrame:
    """A frame with its time.

    image: height × width × 3, uint8, in the colour order of the camera; driver_time_ns: time at which the
    driver stamped it, CLOCK_MONOTONIC of the daemon's machine, ns; age_ms: its age when it was returned.
    markers: with `image: shear`, rows × columns × 5, float32: rest x, rest y, displacement x,
    displacement y in px of the 320 × 240 image, confidence; NaN where the lattice has no marker.
    """

    image: npt.NDArray[np.uint8] = field(repr=False)
    driver_time_ns: int
    age_ms: float
    markers: npt.NDArray[np.float32] | None = field(default=None, repr=False)


class GripcastCamera(Camera):
    """A camera of a gripcast daemon: a thread fetches every image that the daemon serves.

    Errors: `ConnectionError` when the daemon or the camera is not there, `TimeoutError` for a frame that
    does not come or is too old, each with its cause and remedy; `DeviceNotConnectedError` before `connect`.
    """

    config_class = GripcastCameraConfig

    def __init__(self, config: GripcastCameraConfig) -> None:
        super().__init__(config)
        self.config = config
        self._changed = threading.Condition()
        self._served: Served | None = None
        self._fault: Exception | None = None
        self._returned_ns: int | None = None
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()

    def __str__(self) -> str:
        return f"GripcastCamera({self.config.role} {self.config.image}, {self.config.url})"

    @property
    def is_connected(self) -> bool:
        """Whether `connect` has succeeded and `disconnect` has not been called."""
        return self._thread is not None

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """The cameras of the daemon at $GRIPCAST_URL, else http://127.0.0.1:7471.

        Raises `ConnectionError` where none listens.
        """
        url = default_url()
        daemon = Daemon(url)
        try:
            cameras = daemon.cameras()
        finally:
            daemon.close()
        return [
            {
                "name": f"gripcast {camera['role']}",
                "type": "gripcast",
                "id": camera["role"],
                "url": url,
                "product": camera["product"],
                "serial": camera["serial"],
                "port": camera["port"],
                "state": state_text(camera),
                "images": list(IMAGES) if camera["role"] in ("left", "right") else ["raw"],
                "default_stream_profile": {"width": WIDTH, "height": HEIGHT, "fps": camera["nominal_fps"]},
            }
            for camera in cameras
        ]

    def connect(self, warmup: bool = True) -> None:
        """Checks daemon, role and camera, and waits for the first frame unless `warmup` is False.

        Raises `ConnectionError`, with `warmup` also where no frame comes.
        """
        if self.is_connected:
            raise DeviceAlreadyConnectedError(f"{self} is already connected.")
        self._check_role()
        self._served = self._fault = self._returned_ns = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._fetch, args=(self._stop,), name=str(self), daemon=True)
        self._thread.start()
        if not warmup:
            return
        try:
            self._wait(_FIRST_S, None)
        except TimeoutError as error:
            self.disconnect()
            raise ConnectionError(str(error)) from error

    def read(self, color_mode: ColorMode | None = None) -> npt.NDArray[Any]:
        """The next image that is taken after the call. `TimeoutError` if none comes within 5 s."""
        self._check_connected()
        with self._changed:
            newest = self._served.driver_time_ns if self._served else None
        return self._returned(self._wait(_FIRST_S, newest), color_mode).image

    def async_read(self, timeout_ms: float = 200) -> npt.NDArray[Any]:
        """The newest image that was not returned yet. `TimeoutError` if none comes within `timeout_ms`."""
        return self.read_frame(timeout_ms).image

    def read_frame(self, timeout_ms: float = 200) -> TactileFrame:
        """As `async_read`, with driver time, age and, for `image: shear`, the gel markers."""
        self._check_connected()
        return self._returned(self._wait(timeout_ms / 1e3, self._returned_ns))

    def read_latest(self, max_age_ms: float = 500) -> npt.NDArray[Any]:
        """The newest image, at once. `TimeoutError` if it is older than `max_age_ms`.

        `RuntimeError` before the first image.
        """
        self._check_connected()
        with self._changed:
            served = self._served
        if served is None:
            raise RuntimeError(f"{self} has no image yet: {self._cause()}")
        self._check_age(served, max_age_ms)
        return self._frame(served).image

    @property
    def driver_time_ns(self) -> int | None:
        """Driver time of the image that `read` or `async_read` returned last."""
        return self._returned_ns

    def disconnect(self) -> None:
        """Ends the thread."""
        thread = self._thread
        if thread is None:
            raise DeviceNotConnectedError(f"{self} is not connected.")
        self._stop.set()
        # It waits a second for an image at most.
        thread.join(timeout=3.0)
        self._thread = None

    def _check_connected(self) -> None:
        if not self.is_connected:
            raise DeviceNotConnectedError(f"{self} is not connected. Call `connect` first.")

    def _check_role(self) -> None:
        cameras = self._cameras()
        roles = [camera["role"] for camera in cameras]
        if self.config.role not in roles:
            raise ConnectionError(f"{self}: the rig has no camera {self.config.role}; it has {', '.join(roles)}")
        camera = cameras[roles.index(self.config.role)]
        if camera["state"] in ("unplugged", "unavailable"):
            raise ConnectionError(f"{self}: the camera is {state_text(camera)}; {_remedy(camera)}")

    def _cameras(self) -> list[dict[str, Any]]:
        """The rig's cameras, once the daemon has started."""
        daemon = self._daemon()
        until = time.monotonic() + _FIRST_S
        try:
            while not (cameras := daemon.cameras()):
                if time.monotonic() > until:
                    raise ConnectionError(f"{self}: the daemon is still starting after {_FIRST_S:g} s; try again")
                time.sleep(_RETRY_S)
        finally:
            daemon.close()
        return cameras

    def _daemon(self) -> Daemon:
        return Daemon(self.config.url, self.config.token_file)

    def _fetch(self, stop: threading.Event) -> None:
        daemon = self._daemon()
        role, image = self.config.role, self.config.image
        newest: int | None = None
        while not stop.is_set():
            served, fault = None, None
            try:
                if image == "shear":
                    served = daemon.markers(role, newest)
                else:
                    served = daemon.image(role, image, newest)
            except Exception as error:  # The reader gets it, and the next request may succeed.
                fault = error
            with self._changed:
                self._fault = fault
                if served is not None:
                    newest = served.driver_time_ns
                    self._served = served
                self._changed.notify_all()
            if fault is not None:
                stop.wait(_RETRY_S)
        daemon.close()

    def _wait(self, timeout_s: float, other_than_ns: int | None) -> Served:
        def is_new() -> bool:
            return self._served is not None and self._served.driver_time_ns != other_than_ns

        with self._changed:
            self._changed.wait_for(is_new, timeout_s)
            served = self._served if is_new() else None
        if served is None:
            raise TimeoutError(f"{self}: no new frame within {timeout_s * 1e3:.0f} ms: {self._cause()}")
        self._check_age(served, self.config.max_age_ms)
        return served

    def _check_age(self, served: Served, max_age_ms: float) -> None:
        age_ms = _age_ms(served)
        if age_ms > max_age_ms:
            raise TimeoutError(
                f"{self}: the latest frame is too old: {age_ms:.0f} ms, at most {max_age_ms:g} ms: {self._cause()}"
            )

    def _cause(self) -> str:
        """Why there is no new frame."""
        fault = self._fault
        if fault is not None:
            return str(fault)
        daemon = self._daemon()
        try:
            camera = next(camera for camera in daemon.cameras() if camera["role"] == self.config.role)
        except (DaemonError, StopIteration) as error:
            return str(error) or "the rig no longer has the camera"
        finally:
            daemon.close()
        return f"the camera is {state_text(camera)}; {_remedy(camera)}"

    def _returned(self, served: Served, color_mode: ColorMode | None = None) -> TactileFrame:
        self._returned_ns = served.driver_time_ns
        return self._frame(served, color_mode)

    def _frame(self, served: Served, color_mode: ColorMode | None = None) -> TactileFrame:
        markers = served.values if self.config.image == "shear" else None
        if markers is None:
            image = served.values
        else:
            image = shear_image(markers, served.m_per_px, self.config.shear_range_mm)
        if (color_mode or self.config.color_mode) == ColorMode.BGR:
            image = image[:, :, ::-1]
        return TactileFrame(np.ascontiguousarray(image), served.driver_time_ns, _age_ms(served), markers)


def shear_image(
    markers: npt.NDArray[np.float32], m_per_px: float, range_mm: float, size: tuple[int, int] = (WIDTH, HEIGHT)
) -> npt.NDArray[np.uint8]:
    """Gel markers as an image in which each marker is a rectangle.

    Red and green are the displacement in x and y: 128 at rest, 1 and 255 for -range_mm and range_mm; blue
    is the confidence, 255 for 1. A lost marker and one that the lattice lacks are (128, 128, 0).
    """
    mm = markers[:, :, 2:4] * (m_per_px * 1e3)
    is_there = np.isfinite(markers).all(axis=2) & (markers[:, :, 4] > 0)
    cells = np.zeros((*markers.shape[:2], 3), np.float32)
    cells[:, :, :2] = 128 + 127 * np.clip(mm / range_mm, -1, 1)
    cells[:, :, 2] = 255 * np.clip(markers[:, :, 4], 0, 1)
    cells[~is_there] = (128, 128, 0)
    width, height = size
    rows = np.arange(height) * cells.shape[0] // height
    columns = np.arange(width) * cells.shape[1] // width
    return np.rint(cells).astype(np.uint8)[rows][:, columns]


def _age_ms(served: Served) -> float:
    return max(0.0, time.monotonic() - served.taken_s) * 1e3


def _remedy(camera: dict[str, Any]) -> str:
    return {
        "unplugged": "plug it in",
        "unavailable": "end the program that uses it, or as the reason says",
        "silent": "replug it",
        "frozen": "replug it",
        "damaged": "replug it, or use another cable or port",
        "opening": "wait for it",
        "live": "the daemon serves fewer images than are read; read at a lower rate or with a longer timeout",
    }.get(str(camera["state"]), "see docs/reference/camera-states.md of gripcast")
