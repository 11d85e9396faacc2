"""With Turkish and German settings, numbers have a decimal point, I stays I, and every file is the same."""

from __future__ import annotations

import json
import locale
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.command import in_process

pytestmark = pytest.mark.behaviour

#: A host program that takes the user's locale, as QGIS does: C libraries then write "1,5". Python itself does not.
PROGRAM = """
import json, locale, sys
from pathlib import Path
from tests.support.command import in_process
taken = locale.setlocale(locale.LC_ALL, "")
out = Path(sys.argv[1])
code = [in_process(*words).code for words in (
    ("simulate", "zonguldak", "--out", out / "twin"),
    ("adjust", out / "twin/project.toml", "--out", out / "result"),
    ("report", out / "result", "--export", out / "result.geojson", "--quiet"),
    ("convert", out / "twin/points.csv", "--from", "csv", "--crs", "EPSG:4979", "--to-crs", "EPSG:32636", "--to", "csv",
     "--out", out / "map.csv"),
    ("rpc", "fit", out / "twin/left.DIM", "--heights", 0, 2000, "--grid", 6, 6, 5, "--out", out / "left_RPC.TXT"),
    ("rpc", "check", out / "left_RPC.TXT"),
)]
said = in_process("validate", out / "twin/project.toml").stdout
print(json.dumps([taken, locale.localeconv()["decimal_point"], code, said]))
"""
#: Content of the files that differs between runs: times and folders.
OCCASION = ("seconds", "memory", "us_per_observation_iteration", "provenance")


def locales(folder: Path, name: str) -> dict[str, str]:
    """Return the environment with a locale: the machine's, or one made here from its sources."""
    environment = {**os.environ, "LC_ALL": name, "PYTHONUTF8": "1"}
    probe = [sys.executable, "-c", "import locale; locale.setlocale(locale.LC_ALL, '')"]
    if subprocess.run(probe, env=environment, capture_output=True, check=False).returncode == 0:
        return environment
    if shutil.which("localedef") is None:
        pytest.skip(f"the machine has no locale {name}, and no localedef to make it")
    made = subprocess.run(
        ["localedef", "-i", name.partition(".")[0], "-f", "UTF-8", str(folder / name)], capture_output=True, check=False
    )
    environment["LOCPATH"] = str(folder)
    if subprocess.run(probe, env=environment, capture_output=True, check=False).returncode != 0:
        pytest.skip(f"the machine has no locale {name}, and none can be made: {made.stderr.decode()[:80]}")
    return environment


def work(out: Path, environment: dict[str, str]) -> tuple[str, str, list[int], str]:
    """Return the locale, its decimal point, exit codes, and what is said of the project."""
    ended = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(out)], env=environment, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    taken, point, codes, said = json.loads(ended.stdout.splitlines()[-1])
    return taken, point, codes, without_memory(said)


def without_memory(said: str) -> str:
    """Return the words of ``validate`` but for the memory that is free at the moment."""
    return "\n".join(line for line in said.splitlines() if not line.startswith("memory"))


def files(out: Path) -> dict[str, object]:
    """Return the content of every file, without what belongs to the occasion."""
    found: dict[str, object] = {}
    for path in sorted(p for p in out.rglob("*") if p.is_file()):
        name = path.relative_to(out).as_posix()
        if name.endswith("result.json"):
            record = json.loads(path.read_text("utf-8"))
            found[name] = {key: value for key, value in record.items() if key not in OCCASION}
        elif name.endswith("iterations.jsonl"):
            lines = [json.loads(line) for line in path.read_text("utf-8").splitlines()]
            found[name] = [{k: v for k, v in line.items() if k != "seconds"} for line in lines]
        elif not name.endswith((".html", ".npz", "manifest.json")):  # a manifest has the digests of these
            found[name] = path.read_bytes()
    return found


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Return the same work without a locale."""
    out = tmp_path_factory.mktemp("plain")
    taken, point, codes, said = work(out, {**os.environ, "LC_ALL": "C.UTF-8"})
    assert point == "." and codes == [0] * 6, (taken, codes)
    return out, said


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tr_TR.UTF-8", "de_DE.UTF-8"])
def test_files_and_words_do_not_depend_on_the_locale(plain: tuple[Path, str], tmp_path: Path, name: str) -> None:
    out = tmp_path / "work"
    out.mkdir()
    taken, point, codes, said = work(out, locales(tmp_path, name))
    assert (point, codes) == (",", [0] * 6), taken
    assert said == plain[1].replace(str(plain[0]), str(out))
    ours, theirs = files(out), files(plain[0])
    assert list(ours) == list(theirs) and len(ours) > 15
    assert [file for file, content in ours.items() if content != theirs[file]] == []
    pages = [(folder / "result/report.html").read_text("utf-8") for folder in (out, plain[0])]
    parts = [page.partition("<main")[2].partition('<section id="provenance"')[0] for page in pages]
    of_work = [re.sub(r"<b>[^<]*</b><span>[^<]* µs per", "", part) for part in parts]
    assert len(of_work[0]) > 10_000 and of_work[0] == of_work[1]


@pytest.mark.slow
def test_numbers_keep_their_point_in_this_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Commands write the same files and messages under the Turkish locale as under C.

    GDAL compares names by the locale's case, and rejects its own options where i is not the small form of I. This is
    the fast version of the tests in other processes.
    """
    environment = locales(tmp_path, "tr_TR.UTF-8")
    if "LOCPATH" in environment:
        monkeypatch.setenv("LOCPATH", environment["LOCPATH"])
    before = locale.setlocale(locale.LC_ALL)
    written = []
    try:
        for taken in ("C", "tr_TR.UTF-8"):
            locale.setlocale(locale.LC_ALL, taken)
            out = tmp_path / f"under {taken}"
            assert in_process("simulate", "zonguldak", "--out", out).code == 0
            words = ("--from", "csv", "--crs", "EPSG:4979", "--to-crs", "EPSG:32636", "--out", out / "points.geojson")
            assert in_process("convert", out / "points.csv", *words).code == 0
            assert in_process("convert", out / "points.csv", *words[:-1], out / "points.gpkg").code == 0
            (out / "points.gpkg").unlink()  # it holds the time
            said = in_process("validate", out / "project.toml").stdout
            written.append((files(out), without_memory(said).replace(str(out), "")))
        assert locale.localeconv()["decimal_point"] == ","
    finally:
        locale.setlocale(locale.LC_ALL, before)
    assert written[0] == written[1] and len(written[0][0]) >= 8
    assert "ERROR" not in capfd.readouterr().err
