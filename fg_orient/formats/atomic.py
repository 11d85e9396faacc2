"""Write files and folders completely or not at all.

The output is first written to a hidden file or folder in the same directory. When it is
complete, it is renamed. If a process is killed, its hidden file remains; the next run removes
it (:mod:`fg_orient.formats.staging`).

An existing folder is kept until the new one is complete. A folder is replaced only if it
contains an output of this program and no other files. This protects a home directory that was
given as ``out`` by mistake. It also protects a result that the user keeps inside a simulated
project.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Final, get_args

from fg_orient.formats.staging import claimed, held, linked, publish, sweep, sweep_once, synchronise
from fg_orient.model.errors import InputError
from fg_orient.model.names import TableForm


@contextlib.contextmanager
def staged_file(
    path: str | os.PathLike[str], *, place: str = "", suffix: str = "", durable: bool = False
) -> Iterator[Path]:
    """Give a hidden file to write to. If the block succeeds, rename it to the target; otherwise remove it.

    Parameters
    ----------
    path : path
        Target; its folder must exist. An existing file is replaced.
    place : str
        Option that gave the target; used in messages.
    suffix : str
        Suffix of the hidden file, for writers that require a certain suffix.
    durable : bool
        Wait until the data are on the disk. The file then survives a power failure.

    Raises
    ------
    InputError
        The block or the renaming raised an ``OSError``.
    """
    target = Path(path)
    with writing(path, option="", place=place):
        sweep_once(target.absolute().parent)
        with held(target, suffix) as temporary:
            yield temporary
            if durable:
                synchronise(temporary)
            temporary.replace(target)


@contextlib.contextmanager
def together(*files: Path) -> Iterator[None]:
    """Restore several files if the block that changes them raises an exception; new files are removed.

    Parameters
    ----------
    *files : Path
        Files that the block replaces or creates; their folders must exist.

    Raises
    ------
    InputError
        A folder cannot be written.
    """
    with contextlib.ExitStack() as stack:
        kept: dict[Path, Path | None] = {}
        for file in files:
            kept[file] = None
            if file.exists():
                with writing(file, option=""):
                    backup = kept[file] = stack.enter_context(held(file))
                    linked(file, backup)
        try:
            yield
        except BaseException:
            for file, old in kept.items():
                with contextlib.suppress(OSError):
                    file.unlink() if old is None else old.replace(file)
            raise


@contextlib.contextmanager
def alone(*files: Path) -> Iterator[None]:
    """Exclude other runs that call this function from files, while the block reads or writes them.

    Parameters
    ----------
    *files : Path
        Files in missing folders are ignored: their writer refuses them.

    Raises
    ------
    InputError
        Another run writes one of them, or its folder cannot be written.
    """
    with contextlib.ExitStack() as stack:
        # always in the same order, so that two processes never wait for each other
        for file in sorted({file.absolute() for file in files}):
            if file.parent.is_dir():
                with writing(file, option=""):
                    sweep_once(file.parent)
                    try:
                        stack.enter_context(claimed(file))
                    except BlockingIOError:
                        raise InputError.of("output.busy", file=file) from None
        yield


@contextlib.contextmanager
def outputs(*files: Path | None, overwrite: bool, option: str = "out") -> Iterator[None]:
    """Files that the block writes: all of them or, if it ends with an exception, none.

    No other run writes them at the same time. A file that exists now, also if another run wrote it during the
    computation, is replaced only with ``overwrite``.

    Parameters
    ----------
    *files : Path, optional
        None: not a file. A folder is not put back.
    overwrite : bool
    option : str
        Option that named them, for messages.

    Raises
    ------
    InputError
        A file exists, is being written by another run, or its folder cannot be written.
    """
    wanted = [file for file in files if file is not None]
    with alone(*wanted):
        require_free_files(*wanted, overwrite=overwrite, option=option)
        several = [file for file in wanted if not file.is_dir()] if len(wanted) > 1 else []
        with together(*several):
            yield


@contextlib.contextmanager
def made_folder(folder: Path, out: str | Path | None = None) -> Iterator[None]:
    """Folder for outputs of the block, with its parents; if it ends with an exception, those that are new are removed.

    InputError: it cannot be made; ``out`` is the output that the message names.
    """
    new = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        with writing(out or folder, option="out" if out else ""):
            folder.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        for path in new:
            with contextlib.suppress(OSError):
                path.rmdir()
        raise


def write_bytes(path: str | os.PathLike[str], data: bytes, *, durable: bool = True) -> None:
    """Write a file atomically; an existing file is replaced.

    For ``durable`` see :func:`staged_file`. InputError: the folder is missing, the permission
    is missing or the disk is full; no part of the file remains.
    """
    with (
        staged_file(path, durable=durable) as temporary,
        temporary.open("xb") as stream,  # "x" refuses a link that another user placed here
    ):
        stream.write(data)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write UTF-8 text atomically without a change of line ends; see :func:`write_bytes`."""
    write_bytes(path, text.encode("utf-8"))


def write_lines(path: str | os.PathLike[str], lines: Iterable[str]) -> None:
    """Write the lines of a UTF-8 text file atomically; see :func:`write_bytes`."""
    write_text(path, "\n".join([*lines, ""]))


# --- folders -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Contents:
    """Contents of a kind of output folder.

    Parameters
    ----------
    mark : str
        Name of a file that only this kind of output contains.
    names : tuple of str
        All files of the output, relative to the folder; ``*`` matches any name.
    """

    mark: str
    names: tuple[str, ...]

    def folders(self, folder: Path) -> list[Path]:
        """Return the folders inside an output folder that the output has."""
        inside = {PurePath(name).parent for name in self.names} - {PurePath()}
        return [folder / one for one in sorted(inside) if not (folder / one).is_symlink()]

    def first_foreign(self, folder: Path) -> str:
        """Return the first file or folder that does not belong to the output; "" if all belong to it."""
        for path in sorted(folder.rglob("*")):
            name = path.relative_to(folder)
            is_folder = path.is_dir() and not path.is_symlink()
            wanted = [p for pattern in self.names for p in (PurePath(pattern).parents if is_folder else [pattern])]
            if not any(len(PurePath(w).parts) == len(name.parts) and name.match(str(w)) for w in wanted):
                return name.as_posix()
        return ""


def in_all_forms(*tables: str) -> tuple[str, ...]:
    """Return the file names of tables in all formats of the option ``tables``."""
    return tuple(f"{table}.{form}" for table in tables for form in get_args(TableForm))


#: File names of the tables of a result folder.
RESULT_TABLES: Final = in_all_forms("eop", "points", "residuals", "accuracy", "outliers", "jitter", "start_points")
#: Contents of a result folder of ``adjust``.
RESULT: Final = Contents(
    "result.json",
    ("result.json", *RESULT_TABLES, "iterations.jsonl", "arrays.npz", "covariance.npz", "manifest.json",
     "report.html", "rpc/*_RPC.TXT",
     "figures/*.svg", "figures/*.pdf", "figures/captions.md"),
)  # fmt: skip


def require_free(out: Path, *, overwrite: bool, contents: Contents = RESULT) -> None:
    """Refuse an output folder that must not be overwritten; call this before the computation.

    Parameters
    ----------
    out : Path
        The output folder.
    overwrite : bool
        Allow an existing folder if it is empty, or if it contains the mark and no foreign files.
    contents : Contents
        Files that belong to the output.

    Raises
    ------
    InputError
        The folder exists and must not be replaced. The message names the first foreign file.
    """
    for folder in (out.absolute().parent, out, *contents.folders(out)):
        sweep(folder)
    if not (out.exists() or out.is_symlink()):
        return
    if out.is_symlink() or not out.is_dir():
        raise InputError.of("output.not_a_folder", file=out, option="out")
    if not overwrite:
        raise InputError.of("output.exists", file=out, option="out")
    foreign = contents.first_foreign(out)
    unmarked = any(out.iterdir()) and not (out / contents.mark).is_file()
    if foreign or unmarked:
        value = foreign or f"no {contents.mark}"
        raise InputError.of("output.foreign", file=out, option="out", value=value, mark=contents.mark)


def require_free_files(*files: Path | None, overwrite: bool, option: str = "out") -> None:
    """Raise InputError if a file exists and ``overwrite`` is False; None means no file.

    Call it before computing.
    """
    for file in files:
        if file is None or not os.path.lexists(file):
            continue
        if not (file.is_file() or file.is_dir()):
            raise InputError.of("output.not_a_file", file=file, option=option)
        if not overwrite:
            raise InputError.of("output.exists", file=file, option=option)


@contextlib.contextmanager
def writing(out: str | os.PathLike[str], *, option: str = "out", place: str = "") -> Iterator[None]:
    """Convert an OSError or an error of GDAL into an InputError that names the output.

    The block must only write.
    """
    try:
        yield
    except Exception as error:
        if not (isinstance(error, OSError) or _is_of_gdal(error)):
            raise
        value = getattr(error, "strerror", None) or " ".join(str(error).split())
        raise InputError.of("output.unwritable", file=out, option=option, place=place, value=value) from error


def _is_of_gdal(error: Exception) -> bool:
    """Return whether GDAL raised an exception.

    Its packages have no common class for errors of writing.
    """
    package = type(error).__module__.partition(".")[0]
    return package in ("rasterio", "pyogrio") or (isinstance(error, SystemError) and "GDAL" in str(error))


@contextlib.contextmanager
def staged_folder(out: str | Path, *, overwrite: bool = False, contents: Contents = RESULT) -> Iterator[Path]:
    """Give an empty hidden folder. If the block succeeds, rename it to ``out``; otherwise remove it.

    Parameters
    ----------
    out : path
        The output folder; missing parent folders are created.
    overwrite : bool
        Replace an existing output when the new one is complete.
    contents : Contents
        Files that belong to the output.

    Raises
    ------
    InputError
        ``out`` exists and must not be replaced, or it cannot be written. Exceptions of the
        block are raised unchanged.
    """
    target = Path(out).absolute()
    require_free(target, overwrite=overwrite, contents=contents)
    with contextlib.ExitStack() as stack:
        stack.enter_context(made_folder(target.parent, out))
        with writing(out):
            staging = stack.enter_context(held(target))
            staging.mkdir()
        yield staging
        require_free(target, overwrite=overwrite, contents=contents)  # another process may have made it meanwhile
        with writing(out):
            synchronise(staging)
            try:
                publish(staging, target, replace=overwrite)
            except FileExistsError as error:
                raise InputError.of("output.exists", file=out, option="out") from error
