"""Exceptions: one tree, each with the place of the fault where there is one."""

from __future__ import annotations


class NeedleGuideError(Exception):
    """Base of all errors of this package.

    Attributes:
        message: one line: what was wrong, where, and what is valid.
        path: file or folder that is at fault, where it is one.
        line: line in that file, from 1.
        column: column in that line, in characters from 1.
        field: field of the file or column of the table.
        document: JSON text that was written before the failure, or "".
    """

    def __init__(
        self,
        message: str,
        path: str | None = None,
        line: int | None = None,
        column: int | None = None,
        field: str | None = None,
        document: str = "",
    ) -> None:
        super().__init__(message)
        self.message = message
        self.path = None if path is None else str(path)
        self.line = line
        self.column = column
        self.field = field
        self.document = document

    def __reduce__(self) -> tuple[type[NeedleGuideError], tuple[object, ...]]:
        # Errors cross the borders of processes: Dask and multiprocessing pickle them.
        values = (self.message, self.path, self.line, self.column, self.field, self.document)
        return type(self), values


class UsageError(NeedleGuideError, ValueError):
    """An argument: its name, its shape, its unit or its value."""


class FileError(NeedleGuideError):
    """A file of a session, of summaries, of a model or of a motion program."""


class ArgumentError(UsageError, FileError):
    """An argument that has no place in a session: a value that session files do not allow."""


class AnalysisError(NeedleGuideError):
    """What the data do not allow."""


class DeviceError(NeedleGuideError):
    """The device, or the link to it."""


class InternalError(NeedleGuideError):
    """An error of the package itself."""
