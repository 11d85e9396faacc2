"""Examination of the installation: versions, traps of the environment, a self-test.

The self-test adjusts a synthetic block in memory, in about a second, to see that the installation computes. The
observations of the Zonguldak twin are free of errors here. Its metadata are wrong by constants, which an adjustment
without priors recovers. A sound installation finds the check points to a micrometre; a wrong Jacobian, a broken
compiler cache or a foreign GTSAM does not.
"""

from __future__ import annotations

import grp
import os
import pwd
import stat
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from fg_orient.model.errors import Finding, as_record, finding
from fg_orient.model.installation import OPTIONAL, REQUIRED, shared_file, versions

#: Largest error of the check points: rounding of ECEF coordinates is 1e-9 m, one step leaves 1e-7 m.
TOLERANCE_M: Final = 1e-6


def examine() -> dict[str, Any]:
    """Examine the installation.

    Returns
    -------
    dict
        ``good``; ``versions`` by name (None = missing); ``checks``: list of name, good, detail; ``cache``: ``folders``
        with path, existence, owner and rights of each, ``files`` and ``bytes`` of all (None = no cache);
        ``warnings``, ``findings``.
    """
    found = versions(REQUIRED)
    missing = [name for name, version in found.items() if version is None]
    checks = [{"name": "dependencies", "good": not missing, "detail": ", ".join(missing) or "all installed"}]
    cache: dict[str, Any] = {}
    findings = [*_proj_findings(), *filter(None, [shared_file()])]

    def numba_cache() -> tuple[bool, str]:
        folders = _cache_folders()
        cache.update(examine_cache(folders) if folders else {})
        findings.extend(cache_findings(*folders))
        return True, _describe(cache)

    # the self-test compiles kernels: the cache is examined after it
    for name, check in (("PROJ", _proj), ("self-test", self_test), ("numba cache", numba_cache)):
        try:
            good, detail = check()
        except Exception as error:  # a broken installation may fail in any way
            good, detail = False, f"{type(error).__name__}: {error}"
        checks.append({"name": name, "good": good, "detail": detail})
    return {
        "good": all(check["good"] for check in checks), "versions": found, "checks": checks, "cache": cache or None,
        **as_record(findings), "optional": versions(OPTIONAL),
    }  # fmt: skip


def _proj_findings() -> list[Finding]:
    """Warnings of variables that redirect PROJ; a folder of grids without a database does no harm."""
    text = (
        "installation.proj_variable (warning): is set to {folder}: PROJ may read the data of another installation "
        "-> unset it"
    )
    grids = os.environ.get("PROJ_DATA", "")
    plain = os.path.isdir(grids) and not os.path.isfile(os.path.join(grids, "proj.db"))
    names = filter(os.environ.get, ("PROJ_LIB",) if plain else ("PROJ_LIB", "PROJ_DATA"))
    return [finding(text, place=name, folder=os.environ[name]) for name in names]


def _proj() -> tuple[bool, str]:
    """Transform one point to ECEF and back; the detail is the folder of PROJ's data."""
    import numpy as np

    from fg_orient.geodesy import data_folder, ecef_to_geodetic, geodetic_to_ecef

    there = geodetic_to_ecef([31.85], [41.3], [100.0])
    back = np.array(ecef_to_geodetic(there))[:, 0]
    good = bool(np.abs(back - [31.85, 41.3, 100.0]).max() < 1e-6)
    return good, f"data in {data_folder()}"


def _cache_folders() -> list[Path]:
    """Cache folders of the loaded kernels, one for each folder of sources; without folders that are not writable."""
    from factors._kernel import Kernel

    modules = [module for name, module in sys.modules.items() if name.startswith(("factors.", "fg_orient.kernels."))]
    kernels = [value for module in modules for value in vars(module).values() if isinstance(value, Kernel)]
    found = {Path(kernel.py_func.__code__.co_filename).parent: kernel for kernel in kernels}
    opened = filter(None, (kernel.open_cache() for _, kernel in sorted(found.items())))
    return list(dict.fromkeys(Path(cache.cache_path) for cache in opened))


def examine_cache(folders: Sequence[Path]) -> dict[str, Any]:
    """Path, owner and rights of folders of compiled kernels, which may not exist yet, and their total size."""
    files = [file for folder in folders for file in _inside(folder) if file.suffix in (".nbi", ".nbc")]
    sizes = [status.st_size for _, status in _readable(files)]
    return {"folders": list(map(_rights, folders)), "files": len(sizes), "bytes": sum(sizes)}


def _rights(folder: Path) -> dict[str, Any]:
    """Owner and rights of a folder, or of the nearest parent that exists."""
    there = next(p for p in (folder, *folder.parents) if os.path.exists(p))  # False if not readable
    status = there.stat()
    return {
        "folder": str(folder), "exists": there == folder, "owner": _user(status.st_uid),
        "rights": stat.filemode(status.st_mode)[1:],
    }  # fmt: skip


def _inside(folder: Path) -> list[Path]:
    """Files and folders in a folder, at any depth; unreadable folders are skipped."""
    return sorted(Path(at, name) for at, folders, files in os.walk(folder) for name in (*folders, *files))


def _readable(paths: Iterable[Path]) -> Iterator[tuple[Path, os.stat_result]]:
    """Paths with their status; missing and unreadable paths are skipped."""
    for path in paths:
        with suppress(OSError):
            yield path, path.stat()


def _describe(cache: dict[str, Any]) -> str:
    if not cache:
        return "none"
    texts = [
        f"{one['folder']}, {'' if one['exists'] else 'not made yet; above it: '}owner {one['owner']}, "
        f"rights {one['rights']}" for one in cache["folders"]
    ]  # fmt: skip
    return "; ".join([*texts, f"{cache['files']} files, {cache['bytes'] / 1e6:.1f} MB"])


def cache_findings(*folders: Path) -> list[Finding]:
    """Findings on a cache that is missing, or that other users can change.

    Root and the owner of the program can change the program itself: they give no warning.
    """
    if not folders:
        return [finding(
            "installation.no_cache (warning): there is no place to keep compiled kernels, so that every start compiles "
            "them again -> set NUMBA_CACHE_DIR to a folder of yours that can be written to"
        )]  # fmt: skip
    places = list(dict(place for folder in folders for place in _open_places(folder)).items())
    if not places:
        return []
    path, why = places[0]
    more = f" and {len(places) - 1} more" if len(places) > 1 else ""
    return [finding(
        "installation.cache_open (warning): others can change the compiled kernels in {folder} ({why}); its files hold "
        "pickled code, which is run -> remove what lies there and take the right to write from others (chmod -R go-w), "
        "or set NUMBA_CACHE_DIR to a folder of yours", file=f"{path}{more}", folder=folders[0], why=why,
    )]  # fmt: skip


def _open_places(folder: Path) -> Iterator[tuple[Path, str]]:
    """Parent folders, the folder and its contents that another user can change, with the reason."""
    above = folder.resolve().parents
    for path, status in _readable((*reversed(above), folder, *_inside(folder))):
        # in a sticky folder such as /tmp other users can only add names; the folder below it is tested separately
        sticky = path in above and bool(status.st_mode & stat.S_ISVTX)
        if why := open_to(status, sticky):
            yield path, why


def open_to(status: os.stat_result, sticky: bool) -> str:
    """Description of the users who can change the file; "" if only its owner, root or the program's owner."""
    import factors

    if status.st_uid not in (os.getuid(), 0, Path(factors.__file__).stat().st_uid):
        return f"it belongs to {_user(status.st_uid)}"
    if status.st_mode & stat.S_IWOTH and not sticky:
        return "all users can write there"
    if status.st_mode & stat.S_IWGRP and not sticky and not _own_group(status.st_gid):
        return f"the group {_name(grp.getgrgid, status.st_gid)} can write there"
    return ""


def _own_group(number: int) -> bool:
    """True if the user is the only member of a group, as on many systems."""
    try:
        group = grp.getgrgid(number)
    except KeyError:
        return False
    user = _user(os.getuid())
    return set(group.gr_mem) <= {user, "root"} and (number == 0 or group.gr_name == user)


def _user(number: int) -> str:
    return _name(pwd.getpwuid, number)


def _name(look_up: Callable[[int], Any], number: int) -> str:
    """Name of a user or group; its number if it has no name, as in a container."""
    try:
        return str(look_up(number)[0])
    except KeyError:
        return str(number)


def self_test() -> tuple[bool, str]:
    """Adjust the synthetic block.

    Returns
    -------
    good : bool
        The coordinates of the check points are right within a micrometre.
    detail : str
        Iterations, largest error and time, in words.
    """
    from fg_orient.orientation.orient import adjust
    from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block

    start = time.perf_counter()
    exact = ZonguldakOptions(image_noise_px=0.0, ground_noise_m=(0.0, 0.0, 0.0))
    solution = adjust(zonguldak_block(exact)[0], eop_set="PUA0", priors=False)
    error = float(abs(solution.accuracy.check.ecef_m).max())
    good = solution.status == "converged" and error < TOLERANCE_M
    found = f"{solution.status} after {solution.iterations} iterations, check points within {error:.1e} m"
    return good, f"{found}, {time.perf_counter() - start:.1f} s"
