"""Settings of a camera."""

from __future__ import annotations

import os
from dataclasses import dataclass, field

from lerobot.cameras.configs import CameraConfig, ColorMode

# Size of the images that the daemon serves, px.
WIDTH, HEIGHT = 320, 240
# Images that the daemon serves at most, 1/s.
FPS = 20
IMAGES = ("raw", "difference", "shear")
ROLES = ("left", "right", "rgb", "depth", "external")


def default_url() -> str:
    """Address of the daemon where none is given."""
    return os.environ.get("GRIPCAST_URL", "http://127.0.0.1:7471")


@CameraConfig.register_subclass("gripcast")
@dataclass(kw_only=True)
class GripcastCameraConfig(CameraConfig):
    """A camera of a gripcast daemon.

    role: left, right, rgb, depth or external. image: `raw`, what the camera sees; of a gel `difference`,
    to the initial frame, 128 where nothing has changed; or `shear`, the displacement of the gel markers
    since the initial frame (red: x, green: y, 128 at rest, blue: confidence). url: http://HOST:PORT or
    unix:/PATH of the daemon's socket; $GRIPCAST_URL, else http://127.0.0.1:7471. token_file: the daemon's
    token file, if it has one. color_mode: rgb or bgr. max_age_ms: age above which `read` and `async_read`
    refuse a frame. shear_range_mm: displacement that is shown as full red or green.

    width and height are 320 and 240. fps is 20 and limits nothing: the daemon serves at most that many.
    """

    role: str = "left"
    image: str = "raw"
    url: str = field(default_factory=default_url)
    token_file: str | None = None
    color_mode: ColorMode = ColorMode.RGB
    max_age_ms: float = 500.0
    shear_range_mm: float = 1.0

    def __post_init__(self) -> None:
        self.color_mode = ColorMode(self.color_mode)
        if self.role not in ROLES:
            raise ValueError(f"`role` is expected to be one of {', '.join(ROLES)}, but {self.role!r} is provided.")
        if self.image not in IMAGES:
            raise ValueError(f"`image` is expected to be one of {', '.join(IMAGES)}, but {self.image!r} is provided.")
        if self.image != "raw" and self.role not in ("left", "right"):
            raise ValueError(f"`image: {self.image}` is for the gels, left and right, but `role` is {self.role}.")
        for name, expected in (("width", WIDTH), ("height", HEIGHT)):
            found = getattr(self, name)
            if found not in (None, expected):
                raise ValueError(f"`{name}` is {expected} px for all gripcast cameras, but {found} is provided.")
            setattr(self, name, expected)
        # Robots need a rate.
        self.fps = FPS if self.fps is None else self.fps
        for name in ("max_age_ms", "shear_range_mm"):
            found = getattr(self, name)
            if not 0.0 < found < float("inf"):
                raise ValueError(f"`{name}` must be above 0 and finite, but {found} is provided.")
