"""Commands ``validate``, ``doctor`` and ``schema``: check input and installation, describe JSON output.

``doctor`` reports versions and typical problems of the environment. It also runs a
self-test, which adjusts a synthetic block in memory in about a second. The block is the
synthetic Zonguldak block with observations that have no errors. Its metadata have
constant errors, and an adjustment without priors recovers them. With a correct
installation, the coordinates of the check points are right within a micrometre. With a wrong Jacobian,
a damaged compiler cache or another version of GTSAM, the coordinates are wrong.
"""

from __future__ import annotations

import grp
import json
import os
import pwd
import stat
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from fg_orient.cli.command import argument, command, option
from fg_orient.cli.log import session
from fg_orient.cli.new import OFFICE
from fg_orient.cli.output import answer, emit, end_if, fault, flag, note, say, table, tell, tell_findings
from fg_orient.model.errors import FgOrientError, Finding, InputError, as_record, finding
from fg_orient.model.installation import OPTIONAL, REQUIRED, shared_file, versions
from fg_orient.model.machine import in_gb

if TYPE_CHECKING:
    from fg_orient.formats.registry import Format, Settings
    from fg_orient.model.block import Block


@command(several=OFFICE)
def validate(
    sources: Annotated[list[Path], argument("PROJECT.toml", "Project file; with --format, one or more point files.")],
    format_name: Annotated[
        str, option("Check point files of another program, in this format.", "FORMAT", flag="--format")
    ] = "",
    crs: Annotated[str, option("CRS of the points, if the file does not state it.", "EPSG:N")] = "",
    office: Any = None,
) -> None:
    """Check a project and all its files; report errors (exit code 2), exchanged columns (exit code 4) and remarks."""
    if format_name:
        from fg_orient.formats.registry import Settings

        _validate_points(sources, format_name, Settings(crs, office=office))
        return
    project = sources[0]
    if len(sources) > 1:
        raise InputError.of("cli.one_project", file=sources[1], place="PROJECT.toml", value=f"{len(sources)} files")
    from fg_orient.formats.project import checked_project

    block, problems = checked_project(project)
    need = None
    if block is not None:
        impossible = _impossible(block, project)
        problems += impossible
        if not impossible:
            from fg_orient.quality.mix_ups import mix_ups

            problems += [one.finding(block) for one in mix_ups(block)]
            from fg_orient.adjustment.memory import reduced

            need, _ = reduced(block)
            problems += [] if need.fits else [need.problem(str(project))]
    errors = [p for p in problems if p.severity == "failure"]
    remarks = [p for p in problems if p.severity != "failure"]
    lines = [] if errors or _doubtful(remarks) else ["no errors"]
    if need is not None:
        limit = "" if need.allowed is None else f" of {in_gb(need.allowed)} allowed"
        parts = f" in {need.parts} parts" if need.parts else ""
        lines.insert(0, f"memory: about {need.needed / 1e9:.2g} GB{limit}, backend {need.backend}{parts}")
    _finish({"memory": None if need is None else need.as_dict()}, errors, remarks, lines)


def _finish(record: dict[str, Any], errors: list[Finding], remarks: list[Finding], lines: list[str]) -> None:
    """Print errors, doubts and remarks with the record or the lines; errors and doubts end the command."""
    as_json = session().as_json
    if as_json:
        emit({"errors": [p.as_dict(flag) for p in errors], "remarks": [p.as_dict(flag) for p in remarks], **record})
    for p in errors:
        fault(p)
    if not as_json:
        for p in sorted(remarks, key=lambda p: p.severity != "doubt"):
            tell("doubt" if p.severity == "doubt" else "remark", p, as_result=True)
        for line in lines:
            say(line)
    if errors:
        raise typer.Exit(InputError.exit_code)
    end_if(_doubtful(remarks))


def _doubtful(remarks: list[Finding]) -> bool:
    return any(p.severity == "doubt" for p in remarks)


def _validate_points(paths: list[Path], format_name: str, settings: Settings) -> None:
    """Check point files of another program; an unverified format causes a remark.

    If the format has several files, the files are one survey. Otherwise each file is a survey.
    """
    from fg_orient.formats.registry import format_named

    format_ = format_named(format_name, place="<format>")
    surveys = [paths] if len(format_.files) > 1 else [[path] for path in paths]
    errors: list[Finding] = []
    remarks: list[Finding] = []
    lines, files = [], []
    for survey in surveys:
        counts, own_errors, own_remarks = _checked_points(survey, format_, settings)
        names = [str(path) for path in survey]
        files.append({"files": names, **counts, "n_errors": len(own_errors), "n_remarks": len(own_remarks)})
        if not own_errors:
            name = f"{names[0]}: " if len(surveys) > 1 else ""
            lines.append(f"{name}{counts['points']} points, {counts['image_points']} image points, no errors")
        errors += own_errors
        remarks += own_remarks
    crs_of = {file["crs"] for file in files}
    record = {"points": sum(file["points"] for file in files), "crs": crs_of.pop() if len(crs_of) == 1 else None,
              "files": files}  # fmt: skip
    _finish(record, errors, remarks, lines)


def _checked_points(
    paths: list[Path], format_: Format, settings: Settings
) -> tuple[dict[str, Any], Sequence[Finding], Sequence[Finding]]:
    """Return the numbers of points, the errors and the remarks of one survey."""
    from fg_orient.formats.exchange.convert import read_survey

    try:
        survey, remarks = read_survey(paths, format_, settings, accept_unverified=True)
    except InputError as error:
        return {"points": 0, "image_points": 0, "crs": ""}, error.problems, ()
    counts = {"points": len(survey.ids), "image_points": len(survey.observed), "crs": survey.crs}
    return counts, (), (*survey.notes, *remarks)


def _impossible(block: Block, project: Path) -> list[Finding]:
    """Return the errors that would make ``adjust`` refuse the options."""
    from fg_orient.orientation.run import require_possible_options

    try:
        require_possible_options(block, project, {})
    except InputError as error:
        return list(error.problems)
    return []


@command()
def doctor() -> None:
    """Show versions, check the installation and adjust a small simulated block.

    Exit code 1 if the installation is broken.
    """
    record = examine()
    answer(record, _show_examination)
    if not record["good"]:
        raise typer.Exit(FgOrientError.exit_code)


def _show_examination(record: dict[str, Any]) -> None:
    table("versions", ("name", "version"), [(k, v or "missing") for k, v in record["versions"].items()], left=2)
    checks = [(c["name"], "yes" if c["good"] else "NO", c["detail"]) for c in record["checks"]]
    table("checks", ("check", "good", "detail"), checks, left=3)
    tell_findings(record, as_result=True)
    for c in record["checks"]:
        if session().quiet and not c["good"]:
            note(f"{c['name']}: {c['detail']}")


#: Maximum error of the check points, m. Double precision represents ECEF coordinates within 1e-9 m, and the single
#: iteration of the test leaves errors of 1e-7 m.
TOLERANCE_M: Final = 1e-6


def examine() -> dict[str, Any]:
    """Examine the installation and return what was found.

    Returns
    -------
    dict
        ``good``; ``versions`` by name (None = missing); ``checks``: list of name, good,
        detail; ``cache``: ``folders`` with path, existence, owner and rights of each,
        ``files`` and ``bytes`` of all (None = no cache); ``warnings``, ``findings``.
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

    # the self-test compiles kernels; therefore the cache is examined after it
    for name, check in (("PROJ", _proj), ("self-test", self_test), ("numba cache", numba_cache)):
        try:
            good, detail = check()
        except Exception as error:  # a broken installation may raise any exception
            good, detail = False, f"{type(error).__name__}: {error}"
        checks.append({"name": name, "good": good, "detail": detail})
    return {
        "good": all(check["good"] for check in checks), "versions": found, "checks": checks, "cache": cache or None,
        **as_record(findings), "optional": versions(OPTIONAL),
    }  # fmt: skip


def _proj_findings() -> list[Finding]:
    """Return warnings of environment variables that redirect PROJ.

    A folder with grids but no database is harmless.
    """
    text = (
        "installation.proj_variable (warning): is set to {folder}: PROJ may read the data of another installation "
        "-> unset it"
    )
    grids = os.environ.get("PROJ_DATA", "")
    plain = os.path.isdir(grids) and not os.path.isfile(os.path.join(grids, "proj.db"))
    names = filter(os.environ.get, ("PROJ_LIB",) if plain else ("PROJ_LIB", "PROJ_DATA"))
    return [finding(text, place=name, folder=os.environ[name]) for name in names]


def _proj() -> tuple[bool, str]:
    """Transform a point to ECEF and back; the detail in the result is the folder of PROJ's data."""
    import numpy as np

    from fg_orient.geodesy import data_folder, ecef_to_geodetic, geodetic_to_ecef

    there = geodetic_to_ecef([31.85], [41.3], [100.0])
    back = np.array(ecef_to_geodetic(there))[:, 0]
    good = bool(np.abs(back - [31.85, 41.3, 100.0]).max() < 1e-6)
    return good, f"data in {data_folder()}"


def _cache_folders() -> list[Path]:
    """Return the writable cache folders of the loaded kernels, one for each folder of sources."""
    from factors._kernel import Kernel

    modules = [module for name, module in sys.modules.items() if name.startswith(("factors.", "fg_orient.kernels."))]
    kernels = [value for module in modules for value in vars(module).values() if isinstance(value, Kernel)]
    found = {Path(kernel.py_func.__code__.co_filename).parent: kernel for kernel in kernels}
    opened = filter(None, (kernel.open_cache() for _, kernel in sorted(found.items())))
    return list(dict.fromkeys(Path(cache.cache_path) for cache in opened))


def examine_cache(folders: Sequence[Path]) -> dict[str, Any]:
    """Return path, owner and rights of the folders of compiled kernels, and their total size.

    The folders may not exist yet.
    """
    files = [file for folder in folders for file in _inside(folder) if file.suffix in (".nbi", ".nbc")]
    sizes = [status.st_size for _, status in _readable(files)]
    return {"folders": list(map(_rights, folders)), "files": len(sizes), "bytes": sum(sizes)}


def _rights(folder: Path) -> dict[str, Any]:
    """Return the owner and the rights of a folder.

    If the folder does not exist, its nearest parent is used.
    """
    there = next(p for p in (folder, *folder.parents) if os.path.exists(p))  # also False if a path is not readable
    status = there.stat()
    return {
        "folder": str(folder), "exists": there == folder, "owner": _user(status.st_uid),
        "rights": stat.filemode(status.st_mode)[1:],
    }  # fmt: skip


def _inside(folder: Path) -> list[Path]:
    """Yield all files and folders in a folder, at any depth; unreadable folders are skipped."""
    return sorted(Path(at, name) for at, folders, files in os.walk(folder) for name in (*folders, *files))


def _readable(paths: Iterable[Path]) -> Iterator[tuple[Path, os.stat_result]]:
    """Yield paths with their status; missing and unreadable paths are skipped."""
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
    """Return findings if there is no cache, or if other users can change it.

    There is no warning about root and the owner of the program, because they can change the program itself.
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
        "pickled code, which is run -> delete the files in it and remove the write permission of others "
        "(chmod -R go-w), or set NUMBA_CACHE_DIR to your own folder", file=f"{path}{more}", folder=folders[0], why=why,
    )]  # fmt: skip


def _open_places(folder: Path) -> Iterator[tuple[Path, str]]:
    """Yield paths that another user can change, with the reason: parent folders, the folder, its contents."""
    above = folder.resolve().parents
    for path, status in _readable((*reversed(above), folder, *_inside(folder))):
        # in a sticky folder such as /tmp, other users can only add names; the folder below it is tested separately
        sticky = path in above and bool(status.st_mode & stat.S_ISVTX)
        if why := open_to(status, sticky):
            yield path, why


def open_to(status: os.stat_result, sticky: bool) -> str:
    """Describe the users who can change a file; "" if only its owner, root or the program's owner can."""
    import factors

    if status.st_uid not in (os.getuid(), 0, Path(factors.__file__).stat().st_uid):
        return f"it belongs to {_user(status.st_uid)}"
    if status.st_mode & stat.S_IWOTH and not sticky:
        return "all users can write there"
    if status.st_mode & stat.S_IWGRP and not sticky and not _own_group(status.st_gid):
        return f"the group {_name(grp.getgrgid, status.st_gid)} can write there"
    return ""


def _own_group(number: int) -> bool:
    """Return whether the user is the only member of a group, which is usual on many systems."""
    try:
        group = grp.getgrgid(number)
    except KeyError:
        return False
    user = _user(os.getuid())
    return set(group.gr_mem) <= {user, "root"} and (number == 0 or group.gr_name == user)


def _user(number: int) -> str:
    return _name(pwd.getpwuid, number)


def _name(look_up: Callable[[int], Any], number: int) -> str:
    """Return the name of a user or group.

    If it has no name, as in a container, return its number.
    """
    try:
        return str(look_up(number)[0])
    except KeyError:
        return str(number)


def self_test() -> tuple[bool, str]:
    """Adjust the synthetic block and compare the check points.

    Returns
    -------
    good : bool
        Whether the coordinates of the check points are right within a micrometre.
    detail : str
        Number of iterations, largest error and time, in words.
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


@command()
def schema(
    words: Annotated[
        list[str] | None, argument("COMMAND", "Name of a command, such as adjust or rpc convert; or errors.")
    ] = None,
) -> None:
    """Print the JSON Schema of the --json output of a command; without COMMAND list the commands."""
    folder = Path(__file__).with_name("schemas")
    known = sorted(path.stem for path in folder.glob("*.json"))
    if not words:
        answer({"commands": known}, lambda _: say("\n".join(name.replace("_", " ", 1) for name in known)))
        return
    name = "_".join(words)
    if name not in known:
        from fg_orient.formats.faults import did_you_mean

        hint = did_you_mean(name.replace("_", " "), [one.replace("_", " ") for one in known])
        raise InputError.of("cli.no_schema", place="COMMAND", value=" ".join(words), hint=hint)
    emit(json.loads((folder / f"{name}.json").read_text("utf-8")))
