"""Errors of gripcast."""

from __future__ import annotations


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


class InternalError(Error):
    """A defect of gripcast itself."""
