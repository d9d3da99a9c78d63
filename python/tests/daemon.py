"""A daemon on the virtual rig, for tests."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import threading
from pathlib import Path

# A busy machine paints virtual cameras late.
_WIDE_GUARDS = {
    "GRIPCAST__GUARDS__MAX_FRAME_AGE_MS": "60000",
    "GRIPCAST__GUARDS__MAX_SKEW_MS": "60000",
    "GRIPCAST__GUARDS__MAX_COMMAND_AGE_MS": "60000",
    "GRIPCAST__GUARDS__MIN_FREE_BYTES": "0",
}


class Daemon:
    """Started with a free port, killed by `kill`; `url` and `socket` are where it listens."""

    def __init__(self, program: str, folder: Path, *options: object, rig: str = "virtual") -> None:
        self.dataset = folder / "dataset"
        self.socket = folder / "socket"
        command = [program, "daemon", "--rig", rig, "--dataset", self.dataset, "--socket", self.socket]
        self._process = subprocess.Popen(
            [*map(str, command), "--listen", "127.0.0.1:0", *map(str, options)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, **_WIDE_GUARDS},
        )
        assert self._process.stderr is not None
        said = []
        for line in self._process.stderr:
            said.append(line)
            found = re.search(r"http://127\.0\.0\.1:\d+", line)
            if found:
                self.url = found.group()
                break
        else:
            raise AssertionError("the daemon did not start: " + "".join(said))
        # A full pipe would stop it.
        threading.Thread(target=self._process.stderr.read, daemon=True).start()

    def stop(self) -> None:
        """Ends it properly."""
        self._process.send_signal(signal.SIGTERM)
        self._process.wait()

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()
