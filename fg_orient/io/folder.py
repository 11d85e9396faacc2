"""Folders written whole or not at all: a hidden sibling is filled, then renamed.

An existing folder is kept until the new one is complete, and only a folder that holds a
result of ours may be replaced: ``--out`` pointing at a home directory by mistake must not
cost anything.
"""

from __future__ import annotations

import contextlib
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path

from fg_orient.errors import InputError


def require_free(out: Path, *, overwrite: bool, mark: str) -> None:
    """Refuse an output folder that may not be written; ask before computing anything.

    Parameters
    ----------
    out : Path
        The folder to come.
    overwrite : bool
        Allow an existing folder that holds the file ``mark``, or nothing at all.
    mark : str
        Name of a file that only our own output has.

    Raises
    ------
    InputError
        It exists and may not be replaced.
    """
    if not (out.exists() or out.is_symlink()):
        return
    if out.is_symlink() or not out.is_dir():
        raise InputError.of("output.not_a_folder", file=out, place="--out")
    if not overwrite:
        raise InputError.of("output.exists", file=out, place="--out")
    if not (out / mark).is_file() and any(out.iterdir()):
        raise InputError.of("output.foreign", file=out, place="--out", value=f"no {mark}", mark=mark)


@contextlib.contextmanager
def staged_folder(out: str | Path, *, overwrite: bool = False, mark: str = "result.json") -> Iterator[Path]:
    """Give a temporary folder that becomes ``out`` if the block ends well, else vanishes.

    Parameters
    ----------
    out : path
        The folder to come; missing parents are made.
    overwrite : bool
        Replace an existing folder of ours once the new one is complete.
    mark : str
        Name of a file that only our own output has.

    Yields
    ------
    Path
        An empty folder beside ``out``.

    Raises
    ------
    InputError
        ``out`` exists and may not be replaced, or cannot be written.
    """
    target = Path(out).absolute()
    require_free(target, overwrite=overwrite, mark=mark)
    made = [p for p in (target.parent, *target.parent.parents) if not p.exists()]
    staging = target.with_name(f".{target.name[:200]}.{secrets.token_hex(4)}.tmp")
    done = False
    try:
        staging.mkdir(parents=True)
        yield staging
        require_free(target, overwrite=overwrite, mark=mark)  # somebody else may have been faster
        _replace(target, staging)
        done = True
    except OSError as error:
        raise InputError.of("output.unwritable", file=out, place="--out", value=error.strerror or error) from error
    finally:
        if not done:
            shutil.rmtree(staging, ignore_errors=True)
            for folder in made:
                with contextlib.suppress(OSError):
                    folder.rmdir()


def _replace(target: Path, staging: Path) -> None:
    """Rename the complete folder to its name; the old one goes last."""
    if not target.exists():
        staging.rename(target)
        return
    old = target.with_name(f".{target.name[:200]}.{secrets.token_hex(4)}.old")
    target.rename(old)
    try:
        staging.rename(target)
    except BaseException:
        old.rename(target)
        raise
    shutil.rmtree(old, ignore_errors=True)
