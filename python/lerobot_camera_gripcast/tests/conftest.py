"""A daemon on the virtual rig."""

from __future__ import annotations

import json
import os
import subprocess
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

PREFIX = "page and API: "


class Daemon:
    """A running daemon; `unplug` pulls the cable of cameras."""

    def __init__(self, folder: Path) -> None:
        program = os.environ.get("GRIPCAST_BIN")
        if program is None:
            pytest.fail("GRIPCAST_BIN must name the program: tools/lerobot.sh builds it")
        self._unplugged = folder / "unplugged"
        self._unplugged.write_text("")
        guards = {name: "60000" for name in ("MAX_FRAME_AGE_MS", "MAX_SKEW_MS", "MAX_COMMAND_AGE_MS")}
        environment = os.environ | {f"GRIPCAST__GUARDS__{name}": value for name, value in guards.items()}
        environment["GRIPCAST_VIRTUAL_UNPLUGGED"] = str(self._unplugged)
        command = [program, "daemon", "--rig", "virtual-markers", "--dataset", str(folder / "mugs")]
        command += ["--object", "mug", "--listen", "127.0.0.1:0", "--socket", str(folder / "s")]
        self._process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
        assert self._process.stderr is not None
        said = []
        for line in self._process.stderr:
            said.append(line)
            if line.startswith(PREFIX):
                self.url = line.removeprefix(PREFIX).strip().rstrip("/")
                return
        pytest.fail("".join(said))

    def trigger(self) -> dict[str, Any]:
        """The next step."""
        body = json.dumps({"command": "trigger"}).encode()
        request = urllib.request.Request(
            self.url + "/api/commands", body, {"Content-Type": "application/json"}, method="POST"
        )
        with urllib.request.urlopen(request) as response:
            answer: dict[str, Any] = json.load(response)
        assert answer["result"] == "accepted", answer
        return answer

    def unplug(self, *roles: str) -> None:
        """Pulls these cables and plugs all others in."""
        self._unplugged.write_text(" ".join(roles))

    def stop(self) -> None:
        """Ends it."""
        self._process.terminate()
        self._process.communicate(timeout=30)


@pytest.fixture
def daemon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Daemon]:
    """Before the first initial frame."""
    daemon = Daemon(tmp_path)
    monkeypatch.setenv("GRIPCAST_URL", daemon.url)
    yield daemon
    daemon.stop()
