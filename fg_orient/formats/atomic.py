"""Files and folders written whole or not at all: a hidden sibling is filled, then renamed.

A process that is killed leaves its hidden sibling; the next run removes it (:mod:`fg_orient.formats.staging`).

An existing folder is kept until the new one is complete. A folder is only replaced if it contains an output of this
program and no other files. This protects a home directory that was given by mistake as ``out``, and a result that is
kept inside a simulated project.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Final, get_args

from fg_orient.formats.staging import held, linked, publish, sweep, sweep_once, synchronise
from fg_orient.model.errors import InputError
from fg_orient.model.names import TableForm


@contextlib.contextmanager
def staged_file(
    path: str | os.PathLike[str], *, place: str = "", suffix: str = "", durable: bool = False
) -> Iterator[Path]:
    """Hidden sibling of a file, renamed to the file if the block ends without an exception, else removed.

    Parameters
    ----------
    path : path
        Target; its folder must exist. An existing file is replaced.
    place : str
        Option that named it, for messages.
    suffix : str
        End of the hidden name, for writers that depend on it.
    durable : bool
        Wait until the data are on the disk: the file then survives a power cut.

    Raises
    ------
    InputError
        An ``OSError`` of the block or of the renaming.
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
    """Put files back, or remove new ones, if the block that changes several of them ends with an exception.

    Parameters
    ----------
    *files : Path
        Files that the block replaces or makes; their folders must exist.

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


def write_bytes(path: str | os.PathLike[str], data: bytes, *, durable: bool = True) -> None:
    """Write a file atomically; an existing file is replaced.

    ``durable``: see :func:`staged_file`. An InputError (folder missing, no permission, disk full) leaves no part of
    the file.
    """
    with (
        staged_file(path, durable=durable) as temporary,
        temporary.open("xb") as stream,  # never through a foreign link
    ):
        stream.write(data)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write UTF-8 text atomically, line ends unchanged; see :func:`write_bytes`."""
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
        A file that only this output has.
    names : tuple of str
        All files of the output, relative to the folder, with ``*`` for any name.
    """

    mark: str
    names: tuple[str, ...]

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
    """Names of the files of tables in the forms of the option ``tables``."""
    return tuple(f"{table}.{form}" for table in tables for form in get_args(TableForm))


#: Tables of a result folder.
RESULT_TABLES: Final = in_all_forms("eop", "points", "residuals", "accuracy", "outliers", "start_points")
#: Result folder of ``adjust``.
RESULT: Final = Contents(
    "result.json",
    ("result.json", *RESULT_TABLES, "iterations.jsonl", "arrays.npz", "covariance.npz", "manifest.json",
     "report.html", "rpc/*_RPC.TXT",
     "figures/*.svg", "figures/*.pdf", "figures/captions.md"),
)  # fmt: skip


def require_free(out: Path, *, overwrite: bool, contents: Contents = RESULT) -> None:
    """Refuse an output folder that may not be written; call it before computing.

    Parameters
    ----------
    out : Path
        The output folder.
    overwrite : bool
        Allow an existing folder that is empty, or has the mark and no foreign files.
    contents : Contents
        Of the output.

    Raises
    ------
    InputError
        It exists and may not be replaced; the first foreign file is named.
    """
    for folder in (out.absolute().parent, out):
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
    """Raise InputError if a file exists and ``overwrite`` is False; call it before computing. None: no file."""
    for file in files:
        if file is not None and file.exists() and not overwrite:
            raise InputError.of("output.exists", file=file, option=option)


@contextlib.contextmanager
def writing(out: str | os.PathLike[str], *, option: str = "out", place: str = "") -> Iterator[None]:
    """Convert an OSError, or an error of GDAL, into an InputError that names the output; for blocks that only write."""
    try:
        yield
    except Exception as error:
        if not (isinstance(error, OSError) or _is_of_gdal(error)):
            raise
        value = getattr(error, "strerror", None) or " ".join(str(error).split())
        raise InputError.of("output.unwritable", file=out, option=option, place=place, value=value) from error


def _is_of_gdal(error: Exception) -> bool:
    """Whether an exception comes from GDAL: its packages have no common class for errors of writing."""
    package = type(error).__module__.partition(".")[0]
    return package in ("rasterio", "pyogrio") or (isinstance(error, SystemError) and "GDAL" in str(error))


@contextlib.contextmanager
def staged_folder(out: str | Path, *, overwrite: bool = False, contents: Contents = RESULT) -> Iterator[Path]:
    """Empty sibling of ``out``, renamed to it if the block ends without an exception, else removed.

    Parameters
    ----------
    out : path
        The output folder; missing parents are made.
    overwrite : bool
        Replace an existing output once the new one is complete.
    contents : Contents
        Of the output.

    Raises
    ------
    InputError
        ``out`` exists and may not be replaced, or cannot be written. Exceptions of the block are not changed.
    """
    target = Path(out).absolute()
    require_free(target, overwrite=overwrite, contents=contents)
    made = [p for p in (target.parent, *target.parent.parents) if not p.exists()]
    done = False
    try:
        with contextlib.ExitStack() as stack:
            with writing(out):
                target.parent.mkdir(parents=True, exist_ok=True)
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
        done = True
    finally:
        if not done:
            for folder in made:
                with contextlib.suppress(OSError):
                    folder.rmdir()
