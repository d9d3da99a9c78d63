"""The client and a real daemon on the virtual rig."""

from __future__ import annotations

import http.server
import json
import multiprocessing
import os
import pickle
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gripcast as gc
from daemon import Daemon

TOKEN = "correct-horse-battery"

Condition = Callable[[gc.DaemonState], bool]


@pytest.fixture(scope="module")
def program() -> str:
    return os.environ["GRIPCAST_BIN"]


@pytest.fixture
def daemon(program: str, tmp_path: Path) -> Iterator[Daemon]:
    running = Daemon(program, tmp_path)
    yield running
    running.kill()


@pytest.fixture
def client(daemon: Daemon) -> Iterator[gc.Client]:
    with gc.Client(daemon.url) as client:
        wait(client, are_live)
        yield client


def are_live(state: gc.DaemonState) -> bool:
    cameras = state.data["cameras"]
    return bool(cameras) and all(camera["state"] == "live" for camera in cameras)


def wait(client: gc.Client, condition: Condition) -> gc.DaemonState:
    """The first state with a condition."""
    with client.events() as events:
        for event in events:
            if event.state is not None and condition(event.state):
                return event.state
    raise AssertionError("the daemon has ended")


def take_grasp(client: gc.Client) -> gc.DaemonState:
    assert client.trigger().step == "grasp"
    wait(client, lambda state: len(state.data["gels"]) == 2 and all(g["change"] for g in state.data["gels"].values()))
    try:
        return client.trigger()
    except gc.RefusedError as refused:
        # The virtual gripper may not have closed yet.
        assert refused.can_override and refused.state is not None
        return client.override()


def test_grasps_are_taken_labelled_and_undone(client: gc.Client, daemon: Daemon) -> None:
    assert client.set_object("mug").object == "mug"
    saved = take_grasp(client)
    assert saved.last_grasp is not None and saved.last_outcome == "unlabelled" and saved.step == "label"
    assert client.label("stable").last_outcome == "stable"
    assert client.undo().last_outcome == "unlabelled"
    assert client.redo().last_outcome == "stable"
    assert client.relabel(saved.last_grasp, "slip").last_outcome == "slip"
    assert [grasp["id"] for grasp in client.grasps(object="mug")] == [saved.last_grasp]
    assert list(client.grasps(outcome="stable")) == []
    assert client.grasp(saved.last_grasp)["outcome"] == "slip"
    assert gc.Dataset(daemon.dataset).grasp(saved.last_grasp).object == "mug"
    assert client.trash(saved.last_grasp).last_grasp is None
    client.restore(saved.last_grasp)
    assert client.health()["ok"]


def test_grasps_come_page_by_page(client: gc.Client) -> None:
    with pytest.raises(gc.InputError, match="outcome"):
        next(client.grasps(outcome="lost"))  # type: ignore[arg-type]
    assert list(client.grasps()) == []


def test_command_of_an_older_state_is_refused(client: gc.Client, daemon: Daemon) -> None:
    before = client.state()
    with gc.Client(daemon.url) as other:
        other.trigger()
    with pytest.raises(gc.RefusedError) as caught:
        client.trigger(seen=before)
    refused = caught.value
    assert refused.is_stale and not refused.can_override and refused.state is not None
    assert refused.where == daemon.url and refused.remedy and refused.reasons[0] in refused.what
    assert refused.state.step == "grasp" and refused.state.revision > before.revision
    # What is shown by now is the state of the refusal.
    assert client.undo().step == "initial"
    copy = pickle.loads(pickle.dumps(refused))
    assert copy.is_stale and copy.state == refused.state and str(copy) == str(refused)


def test_nothing_to_do_is_refused(client: gc.Client) -> None:
    for command in (client.undo, client.redo):
        with pytest.raises(gc.RefusedError) as caught:
            command()
        assert not caught.value.is_stale
    with pytest.raises(gc.UsageError, match="no grasp to label"):
        client.label("stable")


def test_frames_have_driver_times(client: gc.Client) -> None:
    frames = client.frames()
    assert {"left", "right"} <= set(frames) == set(client.state().roles)
    for role, frame in frames.items():
        assert frame.role == role and frame.image.dtype == np.uint8 and not frame.image.flags.writeable
        height, width, channels = frame.image.shape
        assert height <= 240 and width <= 320 and channels == 3
        assert 0 <= time.monotonic_ns() - frame.driver_time_ns < 60e9
    assert frames["left"].image.shape == (240, 320, 3)
    newer = frames["left"]
    while newer.driver_time_ns == frames["left"].driver_time_ns:
        newer = client.frame("left")
    assert newer.driver_time_ns > frames["left"].driver_time_ns
    client.trigger()

    def shows_difference() -> bool:
        try:
            image = client.frame("left", "difference").image
        except gc.BusyError as error:
            assert "no initial frame" in str(error)
            return False
        return is_difference(image) and image.std() < frames["left"].image.std()

    # The first images after the trigger may not be compared with the initial frame yet.
    with client.events() as events:
        assert any(shows_difference() for _, _ in zip(range(200), events))
    assert not is_difference(client.frame("left").image)


def is_difference(image: np.ndarray[Any, Any]) -> bool:
    """Grey in the mean: without change it is 128."""
    return bool((abs(image.mean(axis=(0, 1)) - 128) < 20).all())


def test_markers_are_arrays(program: str, tmp_path: Path) -> None:
    daemon = Daemon(program, tmp_path, rig="virtual-markers")
    try:
        client = gc.Client(daemon.url)
        wait(client, are_live)
        with pytest.raises(gc.BusyError, match="no initial frame"):
            client.markers("left")
        client.trigger()
        wait(client, lambda state: [bool(shear["summary"]) for shear in state.data["shear"].values()] == [True, True])
        found = client.markers("left")
    finally:
        daemon.kill()
    rows, columns = found.confidence.shape
    assert rows > 3 and columns > 3 and found.rest_px.shape == found.position_px.shape == (rows, columns, 2)
    tracked = found.confidence > 0
    assert tracked.mean() > 0.5 and np.isfinite(found.position_px[tracked]).all()
    assert (np.isnan(found.rest_px).all(axis=2) == np.isnan(found.confidence)).all()
    assert 1e-5 < found.m_per_px < 1e-4 and 0 < found.driver_time_ns < time.monotonic_ns()


def test_events_tell_what_happens_and_end_with_the_daemon(client: gc.Client, daemon: Daemon) -> None:
    with client.events() as events, gc.Client(daemon.url) as other:
        first = next(events)
        assert first.kind == "state" and first.state is not None
        other.trigger()
        kinds = set()
        for event in events:
            kinds.add(event.kind)
            if event.tone is not None:
                assert event.tone == "initial_saved"
            if kinds == {"state", "tone", "stored"}:
                break
        daemon.stop()
        # The rest, and then the end instead of an error.
        assert all(event.kind in kinds for event in events)
        assert next(events, None) is None


def test_close_ends_events_that_another_thread_waits_for(client: gc.Client) -> None:
    events = client.events()
    next(events)
    count: list[int] = []
    thread = threading.Thread(target=lambda: count.append(sum(1 for _ in events)))
    thread.start()
    events.close()
    thread.join()
    assert len(count) == 1


def test_stopped_daemon_is_unreachable(client: gc.Client, daemon: Daemon) -> None:
    state = client.state()
    daemon.kill()
    for call in (client.state, client.events, lambda: client.trigger(seen=state), lambda: client.frame("left")):
        with pytest.raises(gc.UnreachableError) as caught:
            call()
        assert caught.value.where == daemon.url and "gripcast daemon" in str(caught.value)


def test_token_is_required(program: str, tmp_path: Path) -> None:
    file = tmp_path / "token"
    file.touch(mode=0o600)
    file.write_text(TOKEN)
    daemon = Daemon(program, tmp_path, "--token-file", file)
    try:
        for token in (None, "correct-horse-batterz"):
            client = gc.Client(daemon.url, token)
            for call in (client.state, client.trigger, client.events):
                with pytest.raises(gc.AccessError) as caught:
                    call()
                assert "`token`" in str(caught.value.remedy)
        right = gc.Client(daemon.url, TOKEN)
        assert right.state().step == "initial" and TOKEN not in repr(right)
        with right.events() as events:
            assert next(events).kind == "state"
        with gc.Client(f"unix:{daemon.socket}") as local, local.events() as events:
            assert next(events).state is not None and local.state().revision
    finally:
        daemon.kill()


def fetch_step(client: gc.Client) -> str:
    return client.state().step


def test_forked_process_has_a_connection_of_its_own(client: gc.Client) -> None:
    before = client.state()

    results = multiprocessing.get_context("fork").SimpleQueue()
    child = multiprocessing.get_context("fork").Process(target=lambda: results.put(fetch_step(client)))
    child.start()
    assert results.get() == before.step
    child.join()
    assert client.state().step == before.step


@pytest.mark.parametrize(
    "url", ["127.0.0.1:7471", "ftp://localhost", "http://", "http://host:port", "unix:socket", "http://a/?b=1"]
)
def test_invalid_address_is_explained(url: str) -> None:
    with pytest.raises(gc.UsageError, match="http://HOST:PORT"):
        gc.Client(url)


def test_invalid_arguments_send_nothing() -> None:
    nowhere = gc.Client("http://127.0.0.1:1")
    for call in (
        lambda: gc.Client(token="a\nb"),
        lambda: gc.Client(timeout_s=0),
        lambda: nowhere.relabel("a", "fell"),  # type: ignore[arg-type]
        lambda: nowhere.relabel("a b", "slip"),
        lambda: nowhere.trash(""),
        lambda: nowhere.frame("left", "both"),  # type: ignore[arg-type]
    ):
        with pytest.raises(gc.UsageError):
            call()


class Stranger(http.server.BaseHTTPRequestHandler):
    """Answers as the test says; keeps what it was asked."""

    protocol_version = "HTTP/1.1"
    answers: list[tuple[int, bytes] | None] = []
    bodies: list[dict[str, Any]] = []

    def do_GET(self) -> None:
        self.respond()

    def do_POST(self) -> None:
        length = int(self.headers["Content-Length"])
        self.bodies.append(json.loads(self.rfile.read(length)))
        self.respond()

    def respond(self) -> None:
        answer = self.answers.pop(0)
        if answer is None:
            self.close_connection = True
            return
        status, body = answer
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        pass


@pytest.fixture
def stranger() -> Iterator[str]:
    Stranger.answers, Stranger.bodies = [], []
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Stranger) as server:
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def answer_of(revision: int) -> bytes:
    session = {"revision": revision, "step": "initial", "object": "", "last": None, "undo": None, "redo": None}
    return json.dumps({"session": session, "cameras": [], "prediction": None, "monotonic_ms": 5}).encode()


def test_other_servers_are_told_apart(stranger: str) -> None:
    client = gc.Client(stranger)
    Stranger.answers = [(502, b"<html>Bad Gateway</html>"), (404, b"{}")]
    for _ in range(2):
        with pytest.raises(gc.UnreachableError, match="not that of a daemon"):
            client.state()


def test_repeated_command_keeps_its_id(stranger: str) -> None:
    client = gc.Client(stranger)
    accepted = b'{"result": "accepted", "state": ' + answer_of(8) + b"}"
    # The kept connection breaks in the middle of the command.
    Stranger.answers = [(200, answer_of(7)), None, (200, accepted)]
    seen = client.state()
    assert seen.revision == 7
    assert client.trigger().revision == 8
    first, again = Stranger.bodies
    assert first == again and first["command"] == "trigger"
    assert first["sender"]["seen"] == {"revision": 7} and len(first["sender"]["request_id"]) == 24
    assert first["sender"]["sent_at_ms"] >= 5


def test_command_without_an_answer_may_have_been_executed(stranger: str) -> None:
    client = gc.Client(stranger)
    Stranger.answers = [(200, answer_of(7)), None, None]
    client.state()
    with pytest.raises(gc.UnreachableError, match="may have been carried out"):
        client.trigger()
