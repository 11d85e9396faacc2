"""Files written whole or not at all: a temporary name beside the target, then a rename."""

from __future__ import annotations

import contextlib
import os
import secrets
from pathlib import Path

from fg_orient.errors import InputError


def write_bytes(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a file atomically; an existing one is replaced.

    Parameters
    ----------
    path : path
        Target; its folder must exist.
    data : bytes
        The whole content.

    Raises
    ------
    InputError
        The file cannot be written (folder missing, no permission, disk full); no part of
        it is left behind.
    """
    target = Path(path)
    temporary = target.with_name(f".{target.name[:200]}.{secrets.token_hex(4)}.tmp")
    try:
        # O_EXCL: never through a link that somebody else laid; 0o666 is cut by the umask
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
        with os.fdopen(descriptor, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(target)
    except BaseException as error:
        with contextlib.suppress(OSError):
            temporary.unlink()
        if isinstance(error, OSError):
            raise InputError.of("output.unwritable", file=os.fspath(path), value=error.strerror) from error
        raise


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write UTF-8 text atomically, line ends unchanged; see :func:`write_bytes`."""
    write_bytes(path, text.encode("utf-8"))
