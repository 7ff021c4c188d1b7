"""Folders that are removed with what they belong to."""

from __future__ import annotations

import os
import pathlib
import shutil
import tempfile
import weakref


def _remove(path: str, process: int) -> None:
    # A forked process has the object too, and the folder is not its own.
    if os.getpid() == process:
        shutil.rmtree(path, ignore_errors=True)


class Folder:
    """A temporary folder of the process that has made it; a copy in another process only knows where it is."""

    def __init__(self) -> None:
        self.path = pathlib.Path(tempfile.mkdtemp(prefix="needle-guide-"))
        weakref.finalize(self, _remove, str(self.path), os.getpid())

    def __reduce__(self) -> tuple[type[pathlib.Path], tuple[str]]:
        return pathlib.Path, (str(self.path),)
