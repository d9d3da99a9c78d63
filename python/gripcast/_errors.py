"""Errors of gripcast."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gripcast._client import DaemonState


class Error(Exception):
    """An error of gripcast.

    what: what failed, with expected and found values; where: a path or an item, or None; remedy: how
    to fix it, or None.
    """

    def __init__(self, what: str, where: str | None = None, remedy: str | None = None) -> None:
        # All of them in `args`, so that the error pickles.
        super().__init__(what, where, remedy)
        self.what = what
        self.where = where
        self.remedy = remedy

    def __str__(self) -> str:
        where = f"{self.where}: " if self.where else ""
        remedy = f"\n  → {self.remedy}" if self.remedy else ""
        return f"{where}{self.what}{remedy}"


class UsageError(Error, ValueError):
    """Invalid or contradictory arguments."""


class ConfigError(Error, ValueError):
    """An invalid setting or profile."""


class InputError(Error, ValueError):
    """An invalid array, mesh, model, image or record."""


class NotFoundError(Error):
    """A path or an item does not exist."""


class AccessError(Error):
    """The operating system refuses access."""


class IoError(Error):
    """The operating system reports an IO failure."""


class UnreachableError(IoError):
    """No daemon answers."""


class BusyError(Error):
    """Something is not ready, or has too much to do; try again later."""


class RefusedError(Error):
    """A daemon refused a command, and changed nothing.

    reasons: one sentence per guard; can_override: whether `Client.override` executes it nevertheless;
    is_stale: whether the session had changed since the state that the sender saw, or the command was
    too old; state: the state that the daemon answered with.
    """

    def __init__(
        self,
        what: str,
        where: str | None = None,
        remedy: str | None = None,
        *,
        reasons: tuple[str, ...] = (),
        can_override: bool = False,
        is_stale: bool = False,
        state: DaemonState | None = None,
    ) -> None:
        super().__init__(what, where, remedy)
        self.reasons = reasons
        self.can_override = can_override
        self.is_stale = is_stale
        self.state = state


class InternalError(Error):
    """A defect of gripcast itself."""
