"""Log file of a command: each event adds one line with a JSON object.

Every line contains ``time_utc``, ``run`` (the same for all lines of one command) and
``event``. Events are ``start``, ``stage``, ``iteration``, ``progress``, ``warning``,
``note``, ``remark``, ``lost``, ``error``, ``end``. A line is written immediately and as a
whole. Therefore several commands can write to the same file, and the log of a killed
command is complete up to its last event. Nothing is written to standard output.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import stat
import sys
import time
from collections.abc import Iterator, Mapping
from contextvars import ContextVar
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from fg_orient.model.errors import InputError

#: Every line of a log begins with these characters.
MARK: Final = b'{"time_utc": "'


class LogFile:
    """Log file that is open for appending; it is new or contains earlier commands.

    InputError: the file is not a log, or it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._run = path, secrets.token_hex(4)
        try:
            self._descriptor: int | None = _open(path)
        except OSError as error:
            raise InputError.of("output.unwritable", file=path, option="log", value=error.strerror or error) from error

    def write(self, event: str, **fields: object) -> None:
        """Append a line. If this fails, the log is closed, but the command continues."""
        from fg_orient.result.plain import dumps

        if self._descriptor is None:
            return
        now = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        line = dumps({"time_utc": now, "run": self._run, "event": event, **fields}) + "\n"
        try:
            os.write(self._descriptor, line.encode("utf-8", "backslashreplace"))
        except OSError as error:
            self.close()
            sys.stderr.write(f"warning: {self._path}: the log ends here: {error.strerror}\n")

    def close(self) -> None:
        """Close the log file."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None


def _open(path: Path) -> int:
    """Open a log for appending; another kind of file is refused before it is changed."""
    flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NONBLOCK | getattr(os, "O_CLOEXEC", 0)
    descriptor = os.open(path, flags, 0o666)
    try:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode) or (found.st_size and os.pread(descriptor, len(MARK), 0) != MARK):
            raise InputError.of("log.foreign", file=path, option="log")
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


@dataclass(frozen=True)
class Session:
    """Output settings of the running command.

    Parameters
    ----------
    as_json : bool
        Whether standard output is one JSON object.
    quiet : bool
        Whether tables and progress are omitted.
    log : LogFile or None
    flags : mapping
        Flags of the command's options by the names of the options, and of arguments of the library.
    """

    as_json: bool = False
    quiet: bool = False
    log: LogFile | None = None
    flags: Mapping[str, str] = field(default_factory=dict)

    def tell(self, event: str, **fields: object) -> None:
        """Write an event to the log, if there is a log."""
        if self.log is not None:
            self.log.write(event, **fields)


_SESSION: ContextVar[Session] = ContextVar("session", default=Session())  # noqa: B039 (it is frozen)


def session() -> Session:
    """Return the session of the running command."""
    return _SESSION.get()


@contextlib.contextmanager
def opened(path: Path | None, *, as_json: bool, quiet: bool, flags: Mapping[str, str] | None = None) -> Iterator[None]:
    """Begin a session, and log its start and end; raise InputError if the log cannot be written."""
    begin = time.perf_counter()
    current = Session(as_json, quiet, None if path is None else LogFile(path), flags or {})
    token = _SESSION.set(current)
    code: object = 0
    try:
        if current.log is not None:
            from fg_orient.model.installation import versions

            current.tell("start", command=["fg-orient", *sys.argv[1:]], folder=str(Path.cwd()), process=os.getpid(),
                         versions=versions())  # fmt: skip
        yield
    except BaseException as error:
        code = getattr(error, "exit_code", getattr(error, "code", 1))
        raise
    finally:
        current.tell("end", exit_code=code, seconds=round(time.perf_counter() - begin, 3))
        _SESSION.reset(token)
        if current.log is not None:
            current.log.close()
