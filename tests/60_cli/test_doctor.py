"""``doctor`` shows versions, conflicts and the cache of kernels, and ends with code 0 without a cache."""

from __future__ import annotations

import grp
import os
import re
import stat
from pathlib import Path
from typing import Any

import pytest

import fg_orient
from fg_orient.cli import checks

pytestmark = pytest.mark.behaviour


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the cache of two files, which only its owner can write to."""
    folder = tmp_path / "above" / "cache"
    (folder / "factors_1").mkdir(parents=True)
    for name in ("a.nbi", "a.1.nbc"):
        (folder / "factors_1" / name).write_bytes(b"0123456789")
    for path in (folder.parent, folder, *folder.rglob("*")):
        path.chmod(0o755 if path.is_dir() else 0o644)
    monkeypatch.setattr(checks, "_cache_folders", lambda: [folder])
    return folder


def test_doctor(run: Any, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PROJ_LIB", "/elsewhere")
    ended = run("doctor", "--json")
    assert ended.code == 0, ended.stdout
    assert {c["name"]: c["good"] for c in ended.json["checks"]} == {
        "dependencies": True, "PROJ": True, "numba cache": True, "self-test": True,
    }  # fmt: skip
    assert ended.json["versions"]["fg_orient"] == fg_orient.__version__
    (warning,) = ended.json["warnings"]
    assert "PROJ_LIB" in warning
    status = cache.stat()
    folder = {"folder": str(cache), "exists": True, "owner": cache.owner(), "rights": "rwxr-xr-x"}
    assert ended.json["cache"] == {"folders": [folder], "files": 2, "bytes": 20}
    assert status.st_uid == os.getuid()
    shown = " ".join(run("doctor").stdout.split())
    assert f"owner {cache.owner()}" in shown and "rights rwxr-xr-x" in shown


def test_doctor_of_a_broken_installation(run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """``doctor`` of a broken installation has exit code 1, names the failures and still makes all other checks."""

    def broken() -> list[Path]:
        raise RuntimeError("numba is broken")

    monkeypatch.setattr(checks, "_cache_folders", broken)
    monkeypatch.setattr(checks, "versions", lambda names: dict.fromkeys(names, "1.0") | {"scipy": None})
    ended = run("doctor", "--json")
    assert ended.code == 1
    examined = {c["name"]: c for c in ended.json["checks"]}
    assert not examined["numba cache"]["good"] and "numba is broken" in examined["numba cache"]["detail"]
    assert not examined["dependencies"]["good"] and examined["dependencies"]["detail"] == "scipy"
    assert examined["self-test"]["good"]


def test_no_cache_is_a_warning_with_a_remedy(run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "_cache_folders", lambda: [])
    ended = run("doctor", "--json")
    assert ended.code == 0, ended.stdout
    assert ended.json["cache"] is None
    (warning,) = ended.json["warnings"]
    assert "every start compiles" in warning and "NUMBA_CACHE_DIR" in warning
    (check,) = [c for c in ended.json["checks"] if c["name"] == "numba cache"]
    assert check["detail"] == "none"


def test_caches_without_a_reason_to_warn(cache: Path) -> None:
    """``doctor`` does not warn of a cache of the user alone, below a sticky folder, or that does not exist.

    An example of a sticky folder is /tmp.
    """
    assert checks.cache_findings(cache) == []
    found = checks.examine_cache([cache, cache / "deep" / "er"])
    assert (found["files"], found["bytes"]) == (2, 20)
    assert [folder["exists"] for folder in found["folders"]] == [True, False]
    assert {folder["rights"] for folder in found["folders"]} == {"rwxr-xr-x"}
    assert checks.cache_findings(cache / "deep" / "er") == []
    cache.parent.chmod(0o1777)
    assert checks.cache_findings(cache) == []


def test_cache_that_may_not_be_read(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A cache that cannot be read counts as absent, without a warning.

    Root may read everything, so that the refusal is simulated.
    """
    true_stat = os.stat

    def refused(path: Any, *args: Any, **options: Any) -> os.stat_result:
        if str(path).startswith(str(cache)):
            raise PermissionError(13, "Permission denied", str(path))
        return true_stat(path, *args, **options)

    with monkeypatch.context() as patched:
        patched.setattr(os, "stat", refused)
        found, warnings = checks.examine_cache([cache]), checks.cache_findings(cache)
    assert (found["folders"][0]["exists"], found["files"], warnings) == (False, 0, [])


@pytest.mark.parametrize(
    ("place", "mode"),
    [
        ("", 0o777),
        ("", 0o1777),  # others cannot change existing files, but can add files
        ("..", 0o777),
        ("factors_1", 0o777),
        ("factors_1/a.nbi", 0o666),
    ],
)
def test_cache_that_others_can_write_to(run: Any, cache: Path, place: str, mode: int) -> None:
    path = Path(os.path.normpath(cache / place))
    path.chmod(mode)
    ended = run("doctor", "--json")
    assert ended.code == 0
    (warning,) = ended.json["warnings"]
    assert warning.startswith(f"{path}: ") and "all users can write there" in warning
    assert "pickled code" in warning and "NUMBA_CACHE_DIR" in warning
    assert f"warning: {warning}" in " ".join(run("doctor").stdout.split())


def test_all_open_places_are_counted(cache: Path) -> None:
    for name in ("a.nbi", "a.1.nbc"):
        (cache / "factors_1" / name).chmod(0o666)
    (warning,) = checks.cache_findings(cache)
    assert str(warning).startswith(f"{cache / 'factors_1' / 'a.1.nbc'} and 1 more: ")


def status(mode: int, user: int, group: int) -> os.stat_result:
    return os.stat_result((stat.S_IFDIR | mode, 0, 0, 1, user, group, 0, 0, 0, 0))


def test_who_can_write(monkeypatch: pytest.MonkeyPatch) -> None:
    """``open_to`` names another owner or a group with other members that can write to a folder.

    Root and the user's own group do not count; in a sticky folder only another owner counts.
    """
    me, stranger = os.getuid(), 54321
    name = checks._user(me)
    groups = {
        1001: grp.struct_group((name, "x", 1001, [])),
        1002: grp.struct_group(("staff", "x", 1002, [])),
        1003: grp.struct_group((name, "x", 1003, ["another"])),
    }
    monkeypatch.setattr(checks.grp, "getgrgid", groups.__getitem__)
    for sticky in (False, True):
        assert checks.open_to(status(0o755, stranger, 1001), sticky) == "it belongs to 54321"
        assert checks.open_to(status(0o755, 0, 1002), sticky) == ""
        assert checks.open_to(status(0o755, me, 1002), sticky) == ""
    assert checks.open_to(status(0o775, me, 1001), False) == ""
    assert checks.open_to(status(0o775, me, 1002), False) == "the group staff can write there"
    assert checks.open_to(status(0o1775, me, 1002), True) == ""
    assert checks.open_to(status(0o775, me, 1003), False) == f"the group {name} can write there"
    assert checks.open_to(status(0o775, me, 999), False) == "the group 999 can write there"  # has no name


def test_doctor_without_numba(fresh: Any) -> None:
    """``doctor`` without numba has exit code 1 and reports the missing module at each check that needs it."""
    ended = fresh("doctor", before="sys.modules['numba'] = None")
    assert (ended.code, ended.stderr) == (1, "")
    text = " ".join(ended.stdout.split())
    assert "dependencies yes" in text
    for name in ("self-test", "numba cache"):
        assert re.search(rf"{name} NO ModuleNotFoundError: [^:]*'?numba", text)
