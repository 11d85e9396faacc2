"""Files written whole or not at all: a temporary name beside the target, then a rename."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path

from fg_orient.model.errors import InputError


@contextlib.contextmanager
def staged_file(path: str | os.PathLike[str], *, place: str = "", suffix: str = "") -> Iterator[Path]:
    """Give a hidden name beside a file that is renamed to it if the block ends well, else removed.

    Parameters
    ----------
    path : path
        Target; its folder must exist. An existing file is replaced.
    place : str
        Option that named it, for messages.
    suffix : str
        End of the hidden name, for writers that look at it.

    Raises
    ------
    InputError
        An ``OSError`` inside the block, or of the renaming.
    """
    target = Path(path)
    temporary = target.with_name(f".{target.name[:200]}.{secrets.token_hex(4)}.tmp{suffix}")
    try:
        yield temporary
        temporary.replace(target)
    except BaseException as error:
        with contextlib.suppress(OSError):
            temporary.unlink()
        if isinstance(error, OSError):
            raise InputError.of(
                "output.unwritable", file=os.fspath(path), place=place, value=error.strerror or error
            ) from error
        raise


def write_bytes(path: str | os.PathLike[str], data: bytes, *, durable: bool = True) -> None:
    """Write a file atomically; an existing one is replaced.

    Parameters
    ----------
    path : path
        Target; its folder must exist.
    data : bytes
        The whole content.
    durable : bool
        Wait until the disk has it: the file then survives a power cut.

    Raises
    ------
    InputError
        The file cannot be written (folder missing, no permission, disk full); no part of
        it is left behind.
    """
    with staged_file(path) as temporary:
        # O_EXCL: never through a link that somebody else laid; 0o666 is cut by the umask
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
        with os.fdopen(descriptor, "wb") as stream:
            stream.write(data)
            stream.flush()
            if durable:
                os.fsync(stream.fileno())


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write UTF-8 text atomically, line ends unchanged; see :func:`write_bytes`."""
    write_bytes(path, text.encode("utf-8"))
