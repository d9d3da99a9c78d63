"""The part of the daemon's HTTP API that cameras use. See docs/reference/api.md of gripcast."""

from __future__ import annotations

import http.client
import io
import json
import socket
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlencode, urlsplit

import numpy as np
import numpy.typing as npt
from PIL import Image

_TIMEOUT_S = 5.0
_DRIVER_TIME = "Gripcast-Driver-Time-Ns"
_AGE = "Gripcast-Age-Ms"


class DaemonError(ConnectionError):
    """The daemon cannot be reached, or has no such image; says what to do."""


class NotReadyError(DaemonError):
    """There is no such image yet."""


@dataclass(frozen=True, eq=False)
class Served:
    """What the daemon sent.

    values: an image, height × width × 3, uint8, RGB; or gel markers, rows × columns × 5, float32: rest x,
    rest y, displacement x, displacement y (px of the 320 × 240 image) and confidence, NaN without a marker.
    driver_time_ns: time at which the driver stamped the frame, CLOCK_MONOTONIC of the daemon's machine.
    taken_s: the same on `time.monotonic()` of this machine, at most the transfer too late.
    m_per_px: scale of the gel markers.
    """

    values: npt.NDArray[Any]
    driver_time_ns: int
    taken_s: float
    m_per_px: float = float("nan")


class Daemon:
    """A connection, for one thread."""

    def __init__(self, url: str, token_file: str | None = None) -> None:
        self.url = url
        parts = urlsplit(url)
        if parts.scheme == "unix" and parts.path.startswith("/"):
            self._connection: http.client.HTTPConnection = _UnixConnection(parts.path)
        elif parts.scheme == "http" and parts.hostname:
            self._connection = http.client.HTTPConnection(parts.hostname, parts.port or 80, timeout=_TIMEOUT_S)
        else:
            raise ValueError(f"`url` is expected to be http://HOST:PORT or unix:/PATH, but {url!r} is provided.")
        self._headers: dict[str, str] = {}
        if token_file is not None:
            token = Path(token_file).expanduser().read_text().strip()
            self._headers["Authorization"] = f"Bearer {token}"

    def close(self) -> None:
        """Closes the connection."""
        self._connection.close()

    def cameras(self) -> list[dict[str, Any]]:
        """The rig's cameras with their states; empty while the daemon starts."""
        cameras: list[dict[str, Any]] = json.loads(self._get("/api/state")[1])["cameras"]
        return cameras

    def image(self, role: str, image: str, after_ns: int | None) -> Served | None:
        """The newest image; waits for another one than that of `after_ns`, None without one in a second."""
        query = {"image": image} | ({} if after_ns is None else {"after": str(after_ns)})
        headers, body = self._get(f"/api/cameras/{role}/image.png?{urlencode(query)}")
        if not body:
            return None
        pixels = np.asarray(Image.open(io.BytesIO(body)))
        return Served(pixels, int(headers[_DRIVER_TIME]), _taken_s(headers))

    def markers(self, role: str, after_ns: int | None) -> Served | None:
        """The gel markers in the newest image; waits as `image`."""
        query = "" if after_ns is None else f"?after={after_ns}"
        headers, body = self._get(f"/api/cameras/{role}/markers{query}")
        if not body:
            return None
        found = json.loads(body)
        nothing = (float("nan"),) * 5
        rows = [nothing if marker is None else _columns(marker) for marker in found["markers"]]
        values = np.array(rows, np.float32).reshape(found["rows"], found["columns"], 5)
        return Served(values, int(found["driver_time_ns"]), _taken_s(headers), float(found["m_per_px"]))

    def _get(self, path: str) -> tuple[http.client.HTTPMessage, bytes]:
        for is_last in (False, True):
            try:
                self._connection.request("GET", path, headers=self._headers)
                response = self._connection.getresponse()
                body = response.read()
                break
            except (OSError, http.client.HTTPException) as error:
                self._connection.close()
                # The daemon closes idle connections.
                if is_last or not isinstance(error, (http.client.RemoteDisconnected, ConnectionError, BrokenPipeError)):
                    raise self._lost(error) from error
        if response.status >= 400:
            raise self._refused(response.status, body)
        return response.headers, body

    def _lost(self, error: Exception) -> DaemonError:
        if isinstance(error, (ConnectionRefusedError, FileNotFoundError)):
            what = "no gripcast daemon listens there"
        elif isinstance(error, TimeoutError):
            what = f"no answer within {_TIMEOUT_S:g} s"
        else:
            what = f"the connection failed: {str(error) or type(error).__name__}"
        remedy = "start it with `gripcast daemon`, or set `url` or GRIPCAST_URL to its address"
        return DaemonError(f"{self.url}: {what}; {remedy}")

    def _refused(self, status: int, body: bytes) -> DaemonError:
        try:
            error = json.loads(body)["error"]
            what, remedy = str(error["what"]), error.get("remedy")
        except (ValueError, KeyError, TypeError):
            return DaemonError(f"{self.url}: not the answer of a gripcast daemon (status {status}); check `url`")
        if status == 401:
            remedy = "set `token_file` to the daemon's token file"
        elif "no initial frame" in what:
            remedy = "save one with the gripper open: trigger it on the page, or POST /api/commands"
        kind = NotReadyError if status == 503 else DaemonError
        return kind(f"{self.url}: {what}" + (f"; {remedy}" if remedy else ""))


class _UnixConnection(http.client.HTTPConnection):
    """HTTP over a Unix socket."""

    def __init__(self, path: str) -> None:
        super().__init__("localhost", timeout=_TIMEOUT_S)
        self._path = path

    def connect(self) -> None:
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.sock.settimeout(self.timeout)
        self.sock.connect(self._path)


def _taken_s(headers: http.client.HTTPMessage) -> float:
    return time.monotonic() - float(headers[_AGE]) / 1e3


def _columns(marker: dict[str, Any]) -> tuple[float, ...]:
    rest, now = marker["rest_px"], marker["position_px"]
    return (*rest, now[0] - rest[0], now[1] - rest[1], marker["confidence"])


def state_text(camera: dict[str, Any]) -> str:
    """State of a camera in words."""
    text = str(camera["state"]).replace("_", " ")
    if "for_s" in camera:
        text += f" for {camera['for_s']:.1f} s"
    if camera.get("reason"):
        text += f" ({camera['reason']})"
    return text
