"""A running daemon: state, events, images, commands and labels."""

from __future__ import annotations

import http.client
import json
import os
import secrets
import socket
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal
from urllib.parse import quote, urlencode, urlsplit

import numpy as np
import numpy.typing as npt

from gripcast import _native
from gripcast._errors import (
    AccessError,
    BusyError,
    Error,
    InputError,
    IoError,
    NotFoundError,
    RefusedError,
    UnreachableError,
    UsageError,
)
from gripcast._websocket import Refused, WebSocket

if TYPE_CHECKING:
    _Role = Literal["left", "right", "rgb", "depth", "external"]
    _Outcome = Literal["stable", "slip", "unlabelled"]

# The daemon answers a command within 20 s.
_TIMEOUT_S = 25.0
# The estimate of the daemon's clock is replaced after this time: clocks drift apart.
_CLOCK_S = 30.0
# Larger responses are files of grasps.
_MAX_RESPONSE_BYTES = 256 << 20
_DRIVER_TIME = "Gripcast-Driver-Time-Ns"
_OUTCOMES = ("stable", "slip", "unlabelled")
_ERRORS: dict[str, type[Error]] = {
    "input": InputError,
    "not_found": NotFoundError,
    "busy": BusyError,
    "unauthorised": AccessError,
    "forbidden": AccessError,
}


@dataclass(frozen=True)
class DaemonState:
    """State of a daemon, as it was when it arrived.

    data: everything, as `GET /api/state` says it.
    """

    data: Mapping[str, Any] = field(repr=False)

    @property
    def revision(self) -> int:
        """Number of the state: every change of the session increases it."""
        return int(self._session["revision"])

    @property
    def step(self) -> Literal["initial", "grasp", "label"]:
        """Next step of the cycle."""
        return self._session["step"]  # type: ignore[no-any-return]

    @property
    def object(self) -> str:
        """Name of the current object; empty if it has none."""
        return str(self._session["object"])

    @property
    def last_grasp(self) -> str | None:
        """Id of the newest grasp."""
        last = self._session["last"]
        return last and str(last["id"])

    @property
    def last_outcome(self) -> _Outcome | None:
        """Outcome of the newest grasp."""
        last = self._session["last"]
        return last and last["outcome"]  # type: ignore[no-any-return]

    @property
    def undo(self) -> str | None:
        """The step that undo reverts."""
        return self._session["undo"]  # type: ignore[no-any-return]

    @property
    def redo(self) -> str | None:
        """The step that redo repeats."""
        return self._session["redo"]  # type: ignore[no-any-return]

    @property
    def roles(self) -> list[_Role]:
        """Cameras of the rig; empty while the daemon starts."""
        return [camera["role"] for camera in self.data["cameras"]]

    @property
    def p_stable(self) -> float | None:
        """Probability of a stable grasp; None without a prediction."""
        prediction = self.data["prediction"]
        return prediction and float(prediction["p_stable"])

    @property
    def monotonic_ms(self) -> int:
        """Time of the state on the clock of the daemon's machine (CLOCK_MONOTONIC), ms."""
        return int(self.data["monotonic_ms"])

    @property
    def _session(self) -> Mapping[str, Any]:
        return self.data["session"]  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Event:
    """Something that happened in a daemon.

    kind: "state", "tone" or "stored"; state: with "state"; tone: with "tone", for instance
    "grasp_saved"; stored: with "stored", an answered change of the dataset.
    """

    kind: Literal["state", "tone", "stored"]
    state: DaemonState | None = None
    tone: str | None = None
    stored: Mapping[str, Any] | None = None


@dataclass(frozen=True, eq=False)
class LiveFrame:
    """Newest image of a camera.

    role: of the camera; image: height × width × 3, uint8, RGB, at most 320 × 240; driver_time_ns: time
    at which the driver stamped the frame, CLOCK_MONOTONIC of the daemon's machine, ns. On the same
    machine `time.monotonic_ns() - driver_time_ns` is the age of the frame.
    """

    role: _Role
    image: npt.NDArray[np.uint8] = field(repr=False)
    driver_time_ns: int


@dataclass(frozen=True, eq=False)
class LiveMarkers:
    """Gel markers in the newest image of a gel.

    role: of the camera; rest_px and position_px: rows × columns × 2, float32, in the initial frame and
    now; confidence: rows × columns, float32, 0 for a lost marker; NaN everywhere without a marker.
    m_per_px: scale; driver_time_ns: as in `LiveFrame`.
    """

    role: _Role
    rest_px: npt.NDArray[np.float32] = field(repr=False)
    position_px: npt.NDArray[np.float32] = field(repr=False)
    confidence: npt.NDArray[np.float32] = field(repr=False)
    m_per_px: float
    driver_time_ns: int


class Events:
    """Events of a daemon, until it ends or `close` is called; a context manager."""

    def __init__(self, client: Client, web_socket: WebSocket) -> None:
        self._client = client
        self._socket = web_socket
        self._is_closed = False

    def __iter__(self) -> Iterator[Event]:
        """The same object."""
        return self

    def __next__(self) -> Event:
        """The next event; a state comes at most ten times per second."""
        while not self._is_closed:
            try:
                text = self._socket.receive()
            except (OSError, ValueError) as error:
                if self._is_closed:
                    break
                self.close()
                raise self._client._lost(error) from error
            event = self._client._event(text)
            if event is not None:
                return event
            if text is None or json.loads(text)["type"] == "shutdown":
                self.close()
        raise StopIteration

    def close(self) -> None:
        """Ends the events, also those that another thread waits for."""
        if not self._is_closed:
            self._is_closed = True
            self._socket.close()

    def __enter__(self) -> Events:
        """The same object."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Closes."""
        self.close()


class Client:
    """A running `gripcast daemon`.

    url: http://HOST:PORT, https:// behind a proxy, or unix:/PATH of its socket; token: content of the
    daemon's token file; timeout_s: longest wait for an answer.

    A command carries what its sender saw and is refused (`RefusedError`, `is_stale`) if the session has
    changed since. What the sender saw is the newest state that a method or an event of this client has
    returned; programs that decide in several threads pass it as `seen`. A command without any state is
    one of the state that the client asks for first. Methods may be called from any thread.
    """

    def __init__(
        self, url: str = "http://127.0.0.1:7471", token: str | None = None, *, timeout_s: float = _TIMEOUT_S
    ) -> None:
        self._address = _Address(url)
        if token is not None and not (token.isascii() and token.isprintable() and token and " " not in token):
            raise UsageError("`token` must be printable ASCII characters", None, "strip the newline of the file")
        if not 0.0 < timeout_s < float("inf"):
            raise UsageError(f"`timeout_s` must be above 0 and finite, found {timeout_s}")
        self._token = token
        self._timeout_s = timeout_s
        self._lock = threading.Lock()
        self._connection: tuple[int, http.client.HTTPConnection] | None = None
        self._shown: DaemonState | None = None
        # Clock of the daemon minus `time.monotonic()`, ms, and the time of the estimate.
        self._clock: tuple[float, float] | None = None

    @property
    def url(self) -> str:
        """Address of the daemon."""
        return self._address.url

    def __repr__(self) -> str:
        return f"<Client of {self.url}>"

    def __enter__(self) -> Client:
        """The same object."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Closes."""
        self.close()

    def close(self) -> None:
        """Closes the connection; the next call opens another one."""
        with self._lock:
            self._drop()

    # What there is.

    def state(self) -> DaemonState:
        """Current state."""
        return self._show(self._get("/api/state"))

    def events(self) -> Events:
        """States and events from now on, over a connection of its own."""
        connection = self._address.connection(self._timeout_s)
        try:
            socket = WebSocket(connection, self._address.prefix + "/api/events", self._headers())
        except Refused as refused:
            body = refused.response.read(_MAX_RESPONSE_BYTES)
            connection.close()
            raise self._failure(refused.response, body) from None
        except (OSError, http.client.HTTPException) as error:
            connection.close()
            raise self._lost(error) from error
        return Events(self, socket)

    def frame(self, role: _Role, image: Literal["raw", "difference"] = "raw") -> LiveFrame:
        """Newest image of a camera: what it sees, or of a gel the difference to the initial frame.

        Without loss, as models see it. The difference is 128 where nothing has changed, in grey levels.
        `BusyError` before the first image, and for a difference without an initial frame.
        """
        if image not in ("raw", "difference"):
            raise UsageError(f"`image` must be raw or difference, found {image!r}")
        headers, body = self._request("GET", f"/api/cameras/{quote(role, safe='')}/image.png?image={image}")
        return LiveFrame(role, _native.decode_image(body), int(headers[_DRIVER_TIME]))

    def frames(self) -> dict[_Role, LiveFrame]:
        """Newest images of all cameras that have one."""
        frames: dict[_Role, LiveFrame] = {}
        for role in self.state().roles:
            try:
                frames[role] = self.frame(role)
            except BusyError:
                # Unplugged, or no image yet.
                continue
        return frames

    def markers(self, role: Literal["left", "right"]) -> LiveMarkers:
        """Gel markers in the newest image of a gel; `BusyError` without an initial frame or markers."""
        found = self._get(f"/api/cameras/{quote(role, safe='')}/markers")
        missing = {"rest_px": [np.nan] * 2, "position_px": [np.nan] * 2, "confidence": np.nan}
        values = [marker or missing for marker in found["markers"]]
        shape = (int(found["rows"]), int(found["columns"]))

        def column(name: str, *sides: int) -> npt.NDArray[np.float32]:
            return np.array([value[name] for value in values], dtype=np.float32).reshape(*shape, *sides)

        return LiveMarkers(
            role,
            column("rest_px", 2),
            column("position_px", 2),
            column("confidence"),
            float(found["m_per_px"]),
            int(found["driver_time_ns"]),
        )

    def health(self) -> dict[str, Any]:
        """Tasks and cameras; `ok` is False if one is stuck, has ended or has a fault."""
        return self._get("/api/health", also=(503,))

    def grasps(
        self,
        *,
        object: str | None = None,
        outcome: _Outcome | None = None,
        since: str | None = None,
        until: str | None = None,
    ) -> Iterator[dict[str, Any]]:
        """Saved grasps, newest first, page by page; times are RFC 3339."""
        query = {"object": object, "outcome": outcome, "since": since, "until": until}
        chosen = {name: value for name, value in query.items() if value is not None}
        while True:
            page = self._get("/api/grasps?" + urlencode(chosen))
            yield from page["grasps"]
            if page["next"] is None:
                return
            chosen["before"] = page["next"]

    def grasp(self, id: str) -> dict[str, Any]:
        """Record of a grasp, as in its grasp.json."""
        return self._get(f"/api/grasps/{quote(id, safe='')}")

    # Commands.

    def trigger(self, *, seen: DaemonState | None = None) -> DaemonState:
        """The next step: saves the initial frame or the grasp. Returns the state after it."""
        return self._command("trigger", seen)

    def override(self, *, seen: DaemonState | None = None) -> DaemonState:
        """Repeats a refused trigger although a guard objects; see `RefusedError.can_override`."""
        return self._command("override", seen)

    def label(self, outcome: Literal["stable", "slip"], *, seen: DaemonState | None = None) -> DaemonState:
        """Labels the newest grasp that the sender saw, once it has been lifted."""
        _check_outcome(outcome)
        seen = seen or self._shown or self.state()
        if seen.last_grasp is None:
            raise UsageError("there is no grasp to label", self.url, "trigger the initial frame and the grasp first")
        return self._command(f"relabel {seen.last_grasp} {outcome}", seen, {"outcome": seen.last_outcome})

    def relabel(self, id: str, outcome: _Outcome) -> DaemonState:
        """Labels any grasp of the dataset; "unlabelled" removes the label."""
        _check_outcome(outcome)
        return self._command(f"relabel {_word('id', id)} {outcome}", None, {})

    def undo(self, *, seen: DaemonState | None = None) -> DaemonState:
        """Reverts the newest step that the sender saw."""
        seen = seen or self._shown or self.state()
        return self._command("undo", seen, {"revision": seen.revision, "undo": seen.undo})

    def redo(self, *, seen: DaemonState | None = None) -> DaemonState:
        """Repeats the step that was reverted."""
        seen = seen or self._shown or self.state()
        return self._command("redo", seen, {"revision": seen.revision, "redo": seen.redo})

    def set_object(self, name: str) -> DaemonState:
        """Name of the object of the following grasps."""
        return self._name("object", name)

    def set_scene(self, name: str) -> DaemonState:
        """Name of the scene of the following grasps."""
        return self._name("scene", name)

    def set_operator(self, name: str) -> DaemonState:
        """Name of the operator of the following grasps."""
        return self._name("operator", name)

    def trash(self, id: str) -> DaemonState:
        """Moves a grasp to the trash of the dataset."""
        return self._command(f"trash {_word('id', id)}", None, {})

    def restore(self, id: str) -> DaemonState:
        """Takes a grasp out of the trash."""
        return self._command(f"restore {_word('id', id)}", None, {})

    # Requests.

    def _command(
        self, command: str, seen: DaemonState | None, compared: Mapping[str, Any] | None = None
    ) -> DaemonState:
        if compared is None:
            compared = {"revision": (seen or self._shown or self.state()).revision}
        return self._change("POST", "/api/commands", {"command": command}, compared)

    def _name(self, what: str, name: str) -> DaemonState:
        return self._change("PUT", f"/api/{what}", {"name": name}, {})

    def _change(self, method: str, path: str, body: dict[str, Any], compared: Mapping[str, Any]) -> DaemonState:
        given = {name: value for name, value in compared.items() if value is not None}
        sender: dict[str, Any] = {"request_id": secrets.token_hex(12), "seen": given}
        if self._clock is not None:
            sender["sent_at_ms"] = time.monotonic() * 1e3 + self._clock[0]
        # A repetition has the same id, so the command is executed once.
        text = json.dumps({**body, "sender": sender}).encode()
        _, answer = self._request(method, path, text, also=(409, 500))
        result = json.loads(answer)
        if "state" not in result:
            raise self._error(result, 500)
        state = self._show(result["state"])
        if result["result"] == "refused":
            raise RefusedError(
                "; ".join(result["reasons"]) or "there is nothing to do",
                self.url,
                _remedy(result),
                reasons=tuple(result["reasons"]),
                can_override=result["can_override"],
                is_stale=result["stale"],
                state=state,
            )
        if result["result"] == "failed":
            raise IoError(f"nothing was changed: {result['error']}", self.url, "look at the daemon's disk")
        return state

    def _show(self, data: Mapping[str, Any]) -> DaemonState:
        state = DaemonState(data)
        now = time.monotonic()
        offset = state.monotonic_ms - now * 1e3
        # The state that was delayed least says most about the clock.
        if self._clock is None or offset >= self._clock[0] or now - self._clock[1] > _CLOCK_S:
            self._clock = (offset, now)
        self._shown = state
        return state

    def _event(self, text: str | None) -> Event | None:
        message: dict[str, Any] = json.loads(text) if text is not None else {"type": "shutdown"}
        kind = message["type"]
        if kind == "state":
            return Event("state", state=self._show(message["state"]))
        if kind == "tone":
            return Event("tone", tone=message["tone"])
        if kind == "stored":
            return Event("stored", stored=message["stored"])
        return None

    def _get(self, path: str, also: tuple[int, ...] = ()) -> dict[str, Any]:
        _, body = self._request("GET", path, also=also)
        found: dict[str, Any] = json.loads(body)
        return found

    def _headers(self) -> dict[str, str]:
        return {} if self._token is None else {"Authorization": f"Bearer {self._token}"}

    def _request(
        self, method: str, path: str, body: bytes | None = None, also: tuple[int, ...] = ()
    ) -> tuple[http.client.HTTPMessage, bytes]:
        headers = self._headers()
        if body is not None:
            headers["Content-Type"] = "application/json"
        with self._lock:
            # The daemon closes idle connections: a kept one that breaks is replaced once.
            kept = self._connection is not None and self._connection[0] == os.getpid()
            try:
                response, answer = self._send(method, path, body, headers)
            except (ConnectionError, http.client.HTTPException) as error:
                if not kept:
                    raise self._lost(error, body is not None) from error
                try:
                    response, answer = self._send(method, path, body, headers)
                except (OSError, http.client.HTTPException) as again:
                    raise self._lost(again, body is not None) from again
            except OSError as error:
                raise self._lost(error, body is not None) from error
        if response.status >= 400 and response.status not in also:
            raise self._failure(response, answer)
        return response.headers, answer

    def _send(
        self, method: str, path: str, body: bytes | None, headers: Mapping[str, str]
    ) -> tuple[http.client.HTTPResponse, bytes]:
        # A forked process does not share its parent's connection.
        if self._connection is None or self._connection[0] != os.getpid():
            self._connection = (os.getpid(), self._address.connection(self._timeout_s))
        connection = self._connection[1]
        try:
            connection.request(method, self._address.prefix + path, body, dict(headers))
            response = connection.getresponse()
            answer = response.read(_MAX_RESPONSE_BYTES)
        except BaseException:
            self._drop()
            raise
        if response.will_close:
            self._drop()
        return response, answer

    def _drop(self) -> None:
        if self._connection is not None and self._connection[0] == os.getpid():
            self._connection[1].close()
        self._connection = None

    def _failure(self, response: http.client.HTTPResponse, body: bytes) -> Error:
        try:
            answer = json.loads(body)
        except ValueError:
            what = f"the answer is not that of a daemon: {response.status} {response.reason}"
            return UnreachableError(what, self.url, "check `url`, and the proxy in front of the daemon if there is one")
        return self._error(answer, response.status)

    def _error(self, answer: Mapping[str, Any], status: int) -> Error:
        error = answer.get("error")
        if not isinstance(error, dict):
            return UnreachableError(f"the answer is not that of a daemon: status {status}", self.url, "check `url`")
        remedy = error.get("remedy")
        if status == 401:
            remedy = "pass the content of the daemon's token file as `token`"
        kind = _ERRORS.get(error["kind"], IoError)
        return kind(error["what"], error.get("where") or self.url, remedy)

    def _lost(self, error: Exception, is_change: bool = False) -> UnreachableError:
        remedy = "start it with `gripcast daemon`, or pass its address as `url`"
        if isinstance(error, (ConnectionRefusedError, FileNotFoundError)):
            return UnreachableError("no daemon listens there", self.url, remedy)
        if isinstance(error, TimeoutError):
            what = f"no answer within {self._timeout_s:g} s"
        else:
            what = f"the connection failed: {str(error) or type(error).__name__}"
        if is_change:
            what += "; the command may have been carried out"
            remedy = "look at the `state` before another command"
        return UnreachableError(what, self.url, remedy)


class _Address:
    """Where a daemon listens."""

    def __init__(self, url: str) -> None:
        self.url = url
        parts = urlsplit(url)
        self._scheme = parts.scheme
        self._path = parts.path
        self.prefix = ""
        wrong = UsageError(
            "`url` must be http://HOST:PORT, https://HOST or unix:/PATH", url, "for instance http://127.0.0.1:7471"
        )
        if parts.scheme == "unix":
            if not parts.path.startswith("/") or parts.netloc:
                raise wrong
            return
        try:
            host, port = parts.hostname, parts.port
        except ValueError:
            raise wrong from None
        if parts.scheme not in ("http", "https") or not host or parts.query or parts.fragment or parts.username:
            raise wrong
        self._host, self._port = host, port
        self.prefix = parts.path.rstrip("/")

    def connection(self, timeout_s: float) -> http.client.HTTPConnection:
        """A connection that opens with its first request."""
        if self._scheme == "unix":
            return _UnixConnection(self._path, timeout_s)
        if self._scheme == "https":
            return http.client.HTTPSConnection(self._host, self._port, timeout=timeout_s)
        return http.client.HTTPConnection(self._host, self._port or 80, timeout=timeout_s)


class _UnixConnection(http.client.HTTPConnection):
    """HTTP over a Unix socket."""

    def __init__(self, path: str, timeout_s: float) -> None:
        super().__init__("localhost", timeout=timeout_s)
        self._path = path

    def connect(self) -> None:
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.sock.settimeout(self.timeout)
        self.sock.connect(self._path)


def _check_outcome(outcome: str) -> None:
    if outcome not in _OUTCOMES:
        raise UsageError(f"`outcome` must be one of {', '.join(_OUTCOMES)}, found {outcome!r}")


def _word(name: str, text: str) -> str:
    if not text or any(character.isspace() for character in text):
        raise UsageError(f"`{name}` must be the id of a grasp, found {text!r}")
    return text


def _remedy(result: Mapping[str, Any]) -> str | None:
    if result["stale"]:
        return "look at the new `state` and decide again"
    return "remove the cause, or call `override`" if result["can_override"] else None
