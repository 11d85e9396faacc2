"""Hidden files and folders for outputs that are being written, protected by lock files.

A hidden output has the name ``.NAME.TOKEN.tmp``. Its lock file ``.NAME.TOKEN.lock`` lies
in the same folder. It is created first and removed last, and it contains the names of
machine and process. The writing process owns the lock (flock). When the process ends for
any reason, the system releases the lock. The next run in this folder can then take the
lock and removes the remaining files. If an old output was moved away and the new output
is not yet in its place, the old output is restored. Some network file systems have no
locks; nothing is removed there.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import platform
import re
import secrets
import shutil
import stat
import sys
import time
from collections.abc import Iterator
from functools import lru_cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

_fcntl: Any = import_module("fcntl") if find_spec("fcntl") else None  # not on Windows

#: Pattern of the names of lock files.
_LOCK: Final = re.compile(r"\.(.+)\.([0-9a-f]{12})\.lock")
#: Maximum length of the output's name in the name of a lock file.
LONGEST: Final = 200
#: Token of the lock that all writers of one output take. Other locks have random tokens.
_CLAIM: Final = "0" * 12
#: Flags to open a lock file, which may be a link or a pipe that another user placed there.
_SAFE: Final = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
#: Pause between two attempts, s. A run that removes old files holds a lock for a moment.
PAUSE_S: Final = 1e-3
#: A lock of another machine is removed when it is older than this, s.
FOREIGN_S: Final = 7 * 86_400.0
#: Maximum number of attempts. Another run may remove a new lock file before it is locked.
TRIES: Final = 100
#: Flags of ``renameat2`` of Linux: exchange two paths; refuse an existing target. Below: the current directory.
_EXCHANGE: Final = 2
_NO_REPLACE: Final = 1
_HERE: Final = -100
#: A system or file system without these functions reports one of these errors.
_NOT_THERE: Final = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK)


@contextlib.contextmanager
def held(target: Path, suffix: str = "") -> Iterator[Path]:
    """Give the name of a hidden file or folder beside an output; remove it at the end if it still exists.

    The caller creates the file or folder.

    Parameters
    ----------
    target : Path
        The output; its folder must exist.
    suffix : str
        Suffix of the hidden name, for writers that require a certain suffix.

    Raises
    ------
    OSError
        The lock cannot be made.
    """
    lock, descriptor = _locked(target)
    staging = lock.with_name(f"{lock.name.removesuffix('.lock')}.tmp{suffix}")
    try:
        yield staging
    finally:
        remove(staging)
        # a writer in C may make further files
        gone = _remove_all(lock.parent, staging.name.removesuffix(suffix)) if suffix else not os.path.lexists(staging)
        if not gone:  # they cannot be removed now: the lock stays, too, so that a later run removes both
            os.close(descriptor)
        else:
            _release(lock, descriptor)


@contextlib.contextmanager
def claimed(target: Path) -> Iterator[None]:
    """Exclude other runs from an output while the block writes it, where the system has locks.

    Raises
    ------
    BlockingIOError
        Another run has it.
    OSError
        The lock cannot be made.
    """
    path = _lock_of(target, _CLAIM)
    for _ in range(TRIES):
        descriptor = os.open(path, os.O_CREAT | os.O_RDWR | _SAFE, 0o666)
        if _take(descriptor) is not False and _is(path, descriptor):
            if _is_lock(descriptor):
                break
            os.close(descriptor)
            raise OSError(errno.EEXIST, f"{path.name} is not a lock file", str(path))
        os.close(descriptor)
        time.sleep(PAUSE_S)
    else:
        raise BlockingIOError(errno.EWOULDBLOCK, os.strerror(errno.EWOULDBLOCK), str(target))
    try:
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"{platform.node()} {os.getpid()}\n".encode())
        yield
    finally:
        _release(path, descriptor)


@contextlib.contextmanager
def scratch_folder(parent: Path) -> Iterator[Path]:
    """Give a new temporary folder that only this user can read.

    The folder is removed at the end, or by a later run. OSError: the folder cannot be created.
    """
    sweep_once(parent)
    with held(parent / "fg-orient") as folder:
        folder.mkdir(mode=0o700)
        yield folder


def _lock_of(target: Path, token: str) -> Path:
    """Return the path of a lock file; IsADirectoryError for a target without a name, such as ``.`` or ``/``."""
    if not target.name:
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(target))
    return target.with_name(f".{target.name[:LONGEST]}.{token}.lock")


def _locked(target: Path) -> tuple[Path, int]:
    """Create a lock file, lock it, and return its path and descriptor."""
    for _ in range(TRIES):
        path = _lock_of(target, secrets.token_hex(6))
        descriptor = os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o666)
        try:
            if not _take(descriptor) or _is(path, descriptor):
                os.write(descriptor, f"{platform.node()} {os.getpid()}\n".encode())
                return path, descriptor
        except BaseException:
            _release(path, descriptor)
            raise
        os.close(descriptor)  # another run has removed the lock file
    raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))


def _release(lock: Path, descriptor: int) -> None:
    """Remove a lock file and release it.

    Where a system cannot remove open files, it is released first.
    """
    if _fcntl is None:
        os.close(descriptor)
    with contextlib.suppress(OSError):
        lock.unlink()
    if _fcntl is not None:
        os.close(descriptor)


def _take(descriptor: int) -> bool | None:
    """Try to take a lock without waiting; False if another process holds it, None if locks are not available."""
    if _fcntl is None:
        return None
    try:
        _fcntl.flock(descriptor, _fcntl.LOCK_EX | _fcntl.LOCK_NB)
    except OSError as error:
        return None if error.errno in _NOT_THERE else False
    return True


def _is_lock(descriptor: int) -> bool:
    """Return whether an open file can be a lock: a regular file with one name, which is not another file of a user."""
    found = os.fstat(descriptor)
    return stat.S_ISREG(found.st_mode) and found.st_nlink == 1


def _is(path: Path, descriptor: int) -> bool:
    """Return whether a path still names the open file."""
    try:
        there, own = path.stat(), os.fstat(descriptor)
    except OSError:
        return False
    return (there.st_dev, there.st_ino) == (own.st_dev, own.st_ino)


def remove(path: Path) -> None:
    """Remove a file or folder if it exists; links are not followed."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            path.unlink()


# --- left by processes that are gone -----------------------------------------------------------------


def sweep(folder: Path) -> None:
    """Remove the hidden files that ended processes have left in a folder.

    Restore outputs that they had moved away.
    """
    try:
        names = sorted(entry.name for entry in os.scandir(folder) if entry.name.endswith(".lock"))
    except OSError:
        return
    for name in names:
        match = _LOCK.fullmatch(name)
        if match is None:
            continue
        with contextlib.suppress(OSError):
            descriptor = os.open(folder / name, os.O_RDWR | _SAFE)
            try:
                if _is_lock(descriptor) and _take(descriptor) and _is(folder / name, descriptor) and _ours(descriptor):
                    _clear(folder, match[1], name.removesuffix(".lock"))
            finally:
                os.close(descriptor)


def _ours(descriptor: int) -> bool:
    """Return whether a lock may be removed: it belongs to this machine, or it is more than a week old.

    On some file systems a lock is valid on one machine only.
    """
    host = os.read(descriptor, 1000).decode("utf-8", "replace").partition(" ")[0]
    return host in ("", platform.node()) or time.time() - os.fstat(descriptor).st_mtime > FOREIGN_S


def _remove_all(folder: Path, *beginnings: str) -> bool:
    """Remove the files and folders with these names, also with a further suffix; False if one is still there."""
    with contextlib.suppress(OSError):
        found = [
            folder / entry.name for entry in os.scandir(folder)
            if any(entry.name == one or entry.name.startswith((f"{one}.", f"{one}-")) for one in beginnings)
        ]  # fmt: skip
        for path in found:
            remove(path)
        return not any(map(os.path.lexists, found))
    return False


@lru_cache(maxsize=256)
def sweep_once(folder: Path) -> None:
    """Call :func:`sweep` once for each folder.

    Some commands write thousands of files to a folder.
    """
    sweep(folder)


def _clear(folder: Path, target: str, stem: str) -> None:
    """Remove the files and folders of a lock, then the lock file."""
    old = folder / f"{stem}.old"
    if old.exists() and not os.path.lexists(folder / target) and len(target) < LONGEST:
        old.rename(folder / target)
    if _remove_all(folder, f"{stem}.tmp", f"{stem}.old"):
        (folder / f"{stem}.lock").unlink()


# --- the last step -----------------------------------------------------------------------------------


def publish(staging: Path, target: Path, *, replace: bool) -> None:
    """Rename a complete folder to its target. An existing target gets the hidden name.

    If the system cannot exchange two folders, the old folder has the suffix ``.old`` for a moment.

    Raises
    ------
    FileExistsError
        The target exists, and ``replace`` is False.
    OSError
        The renaming failed; the old target is unchanged.
    """
    if not os.path.lexists(target) and _renamed(staging, target, _NO_REPLACE):
        return
    if not replace:
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(target))
    if _renamed(staging, target, _EXCHANGE):
        return
    old = staging.with_name(f"{staging.name.removesuffix('.tmp')}.old")
    target.rename(old)
    try:
        staging.rename(target)
    except BaseException:
        if not os.path.lexists(target):  # else another process was faster
            old.rename(target)
        raise
    finally:
        if os.path.lexists(target):
            remove(old)


def _renamed(source: Path, target: Path, how: int) -> bool:
    """Rename with ``renameat2``.

    Return False if the target prevents it or the system does not have it.
    """
    function: Any = None
    if sys.platform.startswith("linux"):
        function = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if function is not None:
        if not function(_HERE, os.fsencode(source), _HERE, os.fsencode(target), how):
            return True
        code = ctypes.get_errno()
        if code in (errno.EEXIST, errno.ENOENT) and os.path.lexists(source):
            return False
        if code not in _NOT_THERE:
            raise OSError(code, os.strerror(code), str(target))
    if how == _EXCHANGE or os.path.lexists(target):
        return False
    source.rename(target)
    return True


def linked(file: Path, name: Path) -> None:
    """Give a file a second name; if the file system has no links, copy the file."""
    try:
        os.link(file, name)
    except OSError as error:
        if error.errno not in (*_NOT_THERE, errno.EPERM, errno.EMLINK):
            raise
        shutil.copy2(file, name)


def synchronise(path: Path) -> None:
    """Wait until a file, or a folder with all its files, is on the disk."""
    folders = [path] if path.is_dir() else []
    files = [] if folders else [path]
    for folder in folders:
        for entry in os.scandir(folder):
            (folders if entry.is_dir(follow_symlinks=False) else files).append(Path(entry.path))
    for one in (*files, *reversed(folders)):
        if one in folders and os.name == "nt":
            continue
        descriptor = os.open(one, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
