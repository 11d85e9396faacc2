"""The tests check printing and logging: quiet commands, narrow terminals, colour, locales, completion."""

from __future__ import annotations

import inspect
import io
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from factors._preparation import on_compilation, report_compilation
from fg_orient.cli import app, command
from fg_orient.cli.app import COMMANDS, declared, help_of
from fg_orient.cli.app import app as application
from fg_orient.cli.log import LogFile, opened, session
from fg_orient.cli.output import emit, table
from fg_orient.cli.progress import describe_steps, duration, progress_bar
from fg_orient.model.errors import InputError
from tests.support.command import Run, entry_point

pytestmark = pytest.mark.behaviour

UTC = re.compile(r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z$")
SHARED = {"quiet", "log", "as_json", "debug"}
#: Wide numbers, an id with a space, a text of several words.
COLUMNS = ("id", "what", "easting, m", "northing, m", "sigma")
ROWS = (("P 1", "the first of them all", "450123.4567", "4590123.4567", "0.0123"), ("2", "", "-", "1.5e-300", "12"))


def events(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text("utf-8").splitlines()]


def commands() -> Iterator[tuple[str, Any]]:
    """Yield the name and function of every command."""
    for name in COMMANDS:
        one = declared(name)
        if isinstance(one, typer.Typer):
            yield from ((f"{name} {found.name}", found.callback) for found in one.registered_commands)
        else:
            yield name, one


def test_the_help_shows_what_each_command_says_of_itself() -> None:
    built: Any = typer.main.get_command(app)
    assert list(built.commands) == built.list_commands(None) == list(COMMANDS)
    assert {name: help_of(name) for name in COMMANDS} == {name: built.get_command(None, name).help for name in COMMANDS}
    assert None not in map(help_of, COMMANDS) and built.get_command(None, "nonsense") is None


def test_every_command_has_the_shared_options() -> None:
    found = dict(commands())
    assert len(found) > 25
    assert {n: SHARED - set(inspect.signature(f).parameters) for n, f in found.items() if n != "completion"} == {
        n: set() for n in found if n != "completion"
    }


# --- the log -----------------------------------------------------------------------------------------


def test_log_of_an_adjustment(run: Any, twin: Path, tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    ended = run("adjust", twin, "--quiet", "--log", log)
    assert (ended.code, ended.stdout, ended.stderr) == (0, "", "")
    found = events(log)
    assert all(UTC.match(line["time_utc"]) for line in found)
    assert len({line["run"] for line in found}) == 1
    assert [found[0]["event"], found[-1]["event"], found[-1]["exit_code"]] == ["start", "end", 0]
    assert found[0]["versions"]["gtsam"]
    record = json.loads((twin.parent / "result" / "result.json").read_text("utf-8"))
    told = [line["iteration"] for line in found if line["event"] == "iteration"]
    assert told == list(range(1, record["iterations"] + 1))
    stages = [line["stage"] for line in found if line["event"] == "stage"]
    assert stages[0] == "reading" and stages[-1] == "writing"
    assert [line["text"] for line in found if line["event"] == "warning"] == record["warnings"] != []


def test_json_stays_one_object_and_the_log_gets_its_warnings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, record = tmp_path / "run.log", {"warnings": ["one", "two"], "n": 1}
    with opened(log, as_json=True, quiet=False):
        emit(record)
    assert json.loads(capsys.readouterr().out) == record
    assert [line["text"] for line in events(log) if line["event"] == "warning"] == ["one", "two"]


def test_log_is_added_to_and_holds_errors(run: Any, tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    for _ in range(2):
        assert run("validate", tmp_path / "none.toml", "--log", log).code == 2
    found = events(log)
    assert [line["event"] for line in found] == ["start", "error", "end"] * 2
    assert len({line["run"] for line in found}) == 2
    assert found[1]["code"] == "project.missing_file" and found[1]["file"] == str(tmp_path / "none.toml")
    assert found[-1]["exit_code"] == 2


@pytest.mark.parametrize("json_option", [(), ("--json",)])
def test_other_files_are_not_added_to(run: Any, tmp_path: Path, json_option: tuple[str, ...]) -> None:
    other = tmp_path / "points.csv"
    other.write_text("id,role\n", encoding="utf-8")
    ended = run("validate", tmp_path / "none.toml", "--log", other, *json_option)
    assert ended.code == 2 and "not a log of fg-orient" in ended.stderr and "none.toml" not in ended.stderr
    assert other.read_text("utf-8") == "id,role\n"
    if json_option:
        assert [p["code"] for p in ended.json["errors"]] == ["log.foreign"]
    for path in (tmp_path, Path(os.devnull), tmp_path / "no" / "such"):
        assert run("validate", tmp_path / "none.toml", "--log", path).code == 2


def test_log_that_ends_does_not_end_the_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = LogFile(tmp_path / "run.log")
    assert log._descriptor is not None
    read_only = os.open(tmp_path / "run.log", os.O_RDONLY)
    os.dup2(read_only, log._descriptor)
    os.close(read_only)
    log.write("note", text="lost")
    log.write("note", text="lost, too")
    assert capsys.readouterr().err.count("the log ends here") == 1


def test_end_is_logged_whatever_happens(tmp_path: Path) -> None:
    for error, code in ((KeyboardInterrupt(), 1), (SystemExit(143), 143), (typer.Exit(4), 4), (ValueError(), 1)):
        path = tmp_path / f"{code}{type(error).__name__}.log"
        with pytest.raises(type(error)), opened(path, as_json=False, quiet=True):
            assert session().quiet
            raise error
        assert events(path)[-1]["exit_code"] == code
        assert not session().quiet and session().log is None


def test_steps_are_logged_once_a_second_and_at_the_end(tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    with opened(log, as_json=True, quiet=False), progress_bar("windows") as tell:
        assert tell is not None
        for done in range(1, 101):
            tell(done, 100, "windows")
    steps = [line["done"] for line in events(log) if line["event"] == "progress"]
    assert steps[0] == 1 and steps[-1] == 100 and len(steps) < 20


def test_other_work_has_a_rate_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A second count of a progress bar starts a new clock. The first hundred steps took ten seconds."""
    clock = [0.0]
    log = tmp_path / "run.log"
    with opened(log, as_json=True, quiet=False), progress_bar("orbits") as tell:
        assert tell is not None
        monkeypatch.setattr("fg_orient.cli.progress.time.perf_counter", lambda: clock[0])
        tell(0, 100, "orbits")
        for clock[0], done, text in ((10.0, 100, "orbits"), (10.0, 0, "images"), (12.0, 10, "images")):
            tell(done, 100, text)
    steps = [(line["text"], line["done"], line["seconds"]) for line in events(log) if line["event"] == "progress"]
    assert steps[-2:] == [("images", 0, 0.0), ("images", 10, 2.0)]


def test_long_commands_tell_how_far_they_are(tmp_path: Path, run: Run) -> None:
    """The log of ``simulate`` has the progress of each stage with its total.

    The rate and time left of a bar come from these steps.
    """
    log = tmp_path / "run.log"
    words = ("--rows", 1, "--columns", 2, "--points", 60, "--out", tmp_path / "block", "--log", log)
    assert run("simulate", "block", *words).code == 0
    counted = {line["text"]: line["total"] for line in events(log) if line["event"] == "progress"}
    assert counted == {"orbits": 2, "ground points": 60, "images taken": 2, "metadata files": 2}


def test_long_compilation_is_noted_once(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """A command prints one note when compilation has taken longer than half a second, and none before."""
    spent = iter([10.0, 10.4, 10.6, 12.0])
    monkeypatch.setattr(command, "preparing_seconds", lambda: next(spent))
    with on_compilation(command._CompilationNote()):
        report_compilation("first")
        assert capsys.readouterr().err == ""
        report_compilation("second")
        assert re.fullmatch(r"note: compiling the kernels of this command, .*\n", capsys.readouterr().err)
        report_compilation("third")
        assert capsys.readouterr().err == ""


def test_words_of_progress() -> None:
    assert describe_steps("windows", 30, 120, 10.0) == "windows 30 of 120, 3.0/s, about 30 s left"
    assert describe_steps("set 5", 2, 20, 60.0) == "set 5 2 of 20, 30 s each, about 9 min left"
    assert describe_steps("", 0, 20, 60.0) == "0 of 20"
    assert [duration(s) for s in (0.4, 99.4, 99.5, 5940.0, 7200.0)] == ["0 s", "99 s", "2 min", "99 min", "2.0 h"]


# --- quiet -------------------------------------------------------------------------------------------


def test_quiet_commands_say_nothing_of_what_is_good(run: Any, twin_source: Path, tmp_path: Path) -> None:
    metadata = twin_source / "left.DIM"
    for words in (
        ("validate", twin_source / "project.toml"),
        ("locate", metadata, "--line", 10, "--sample", 10, "--height", 0, "--out", tmp_path / "points.csv"),
        ("footprint", metadata, "--height", 0, "--out", tmp_path / "footprint.geojson"),
    ):
        ended = run(*words, "--quiet")
        assert (ended.code, ended.stdout, ended.stderr) == (0, "", ""), words
    assert (tmp_path / "points.csv").exists() and (tmp_path / "footprint.geojson").exists()


def test_quiet_commands_say_what_is_wrong(run: Any, tmp_path: Path) -> None:
    assert run("validate", tmp_path / "none.toml", "--quiet").stderr.startswith("error: ")
    points = tmp_path / "check.csv"
    rows = [f"{k},{k % 3 - 1},{k % 2}" for k in range(30)]
    points.write_text("\n".join(["id,residual_easting_m,residual_northing_m", *rows]) + "\n", encoding="utf-8")
    ended = run("rectify", "check", points, "--class-m", 0.1, "--standard", "ASPRS-2023", "--quiet")
    assert ended.code == 4 and ended.stdout == ""
    assert ended.stderr.startswith("ASPRS-2023: failed, "), ended.stderr


# --- tables ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("width", [20, 40, 60, 80, 200])
def test_tables_break_no_number_and_lose_no_column(
    width: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    table("points", COLUMNS, ROWS, left=2)
    out = capsys.readouterr().out
    for name in COLUMNS:
        assert name in out
    for row in ROWS:
        assert all(cell in out for cell in (row[0], *row[2:])), out
        assert all(word in out for word in row[1].split())
    if width >= 40:
        assert max(map(len, out.splitlines())) <= min(width, 80), out


def test_wide_terminals_get_columns_and_narrow_ones_records(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for width, lines in ((80, 2), (40, 0)):
        monkeypatch.setenv("COLUMNS", str(width))
        table("points", COLUMNS, ROWS, left=2)
        out = capsys.readouterr().out.splitlines()
        assert sum(sum(cell in line for cell in ("-", "1.5e-300", "12")) == 3 for line in out) == (lines > 0)
    assert "  easting, m   450123.4567" in out


@pytest.mark.parametrize("columns", [80, 40])
def test_tables_of_commands_fit(columns: int, run: Any, twin_source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    metadata = twin_source / "left.DIM"
    for words in (
        ("locate", metadata, "--frame"),
        ("footprint", metadata, "--height", 0),
        ("convert", "--formats"),
    ):
        ended = run(*words)
        assert ended.code == 0, ended.stderr
        long = [line for line in ended.stdout.splitlines() if len(line) > columns and ": " not in line]
        assert long == [], words
    assert "\N{HORIZONTAL ELLIPSIS}" not in ended.stdout


# --- colour, locale ----------------------------------------------------------------------------------


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("stream", "environment", "escapes"),
    [
        (Terminal, {}, True),
        (Terminal, {"TERM": "dumb"}, False),
        (Terminal, {"NO_COLOR": "1"}, False),
        (io.StringIO, {}, False),
        (io.StringIO, {"FORCE_COLOR": "1"}, True),
        (io.StringIO, {"FORCE_COLOR": "1", "NO_COLOR": "1"}, False),
    ],
)
@pytest.mark.parametrize("columns", ["80", "10"])
def test_escapes_on_terminals_only(
    stream: type[io.StringIO], environment: dict[str, str], escapes: bool, columns: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("NO_COLOR", "FORCE_COLOR"):
        monkeypatch.delenv(name, raising=False)
    for name, value in {"TERM": "xterm-256color", "COLUMNS": columns, **environment}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys, "stdout", stream())
    table("title", ("a", "number"), [("x", "1.5")])
    out = sys.stdout.getvalue()  # type: ignore[attr-defined]
    assert ("\x1b[" in out) == escapes and "1.5" in out


def test_the_help_cuts_no_word() -> None:
    """On 80 columns names of options that are longer than their column are broken, not cut with an ellipsis."""
    words = [sys.executable, "-c", "from fg_orient.cli import main; main()", "adjust", "--help"]
    done = subprocess.run(words, env={**os.environ, "COLUMNS": "80"}, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0 and "--rpc-compensat" in done.stdout and "…" not in done.stdout
    assert max(map(len, done.stdout.splitlines())) <= 80


# --- completion --------------------------------------------------------------------------------------


WORDS = ("fg-orient adjust --qui", "fg-orient rep")
#: What the script of a shell sets to ask for the end of the last word.
ASKED: dict[str, Callable[[str], dict[str, str]]] = {
    "bash": lambda words: {"COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))},
    "zsh": lambda words: {"_TYPER_COMPLETE_ARGS": words},
    "fish": lambda words: {"_TYPER_COMPLETE_ARGS": words, "_TYPER_COMPLETE_FISH_ACTION": "get-args"},
}


@pytest.mark.parametrize("shell", ASKED)
def test_the_program_answers_the_script_of_a_shell(shell: str) -> None:
    """The program completes options and commands for the variables that the script of each shell sets.

    No shell is needed; the slow tests below run the installed shells.
    """
    script = entry_point("completion", shell).stdout
    told = []
    for words in WORDS:
        variables = ASKED[shell](words)
        assert all(f"{name}=" in script for name in variables) and f"_FG_ORIENT_COMPLETE=complete_{shell}" in script
        told.append(entry_point(**variables, _FG_ORIENT_COMPLETE=f"complete_{shell}").stdout)
    assert "--quiet" in told[0] and "--json" not in told[0]
    for word in ("replay", "report", "reproduce"):
        assert word in told[1]
    for other in ("adjust", "doctor", "--quiet"):
        assert other not in told[1]
    assert ("Repeat a run" in told[1]) == (shell != "bash")  # bash shows no help


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash on the path")
def test_bash_completes_options(repository: Path, run: Any) -> None:
    script = run("completion", "bash").stdout
    program = f"fg-orient() {{ PYTHONPATH={repository} {sys.executable} -m fg_orient; }}\nexport -f fg-orient\n"
    asked = script.replace("env COMP_WORDS", "COMP_WORDS") + (
        "\nfor words in 'fg-orient adjust --qui'; do COMP_WORDS=($words); "
        'COMP_CWORD=$((${#COMP_WORDS[@]} - 1)); _fg_orient_completion fg-orient; echo "${COMPREPLY[@]}"; done'
    )
    done = subprocess.run(["bash", "-c", program + asked], capture_output=True, text=True, timeout=600)
    assert (done.stdout.split(), done.stderr) == (["--quiet"], "")


#: What a shell runs to say what it would offer: zsh with the last step of its completion printed instead of shown.
OFFERED = {
    "zsh": """
        autoload -U compinit; compinit -D -u; eval "$(fg-orient completion zsh)"
        [[ ${_comps[fg-orient]} == _fg_orient_completion ]] || exit 9
        _arguments() { print -r -- "$@" }
        words=(fg-orient adjust --qui) CURRENT=3; _fg_orient_completion
        words=(fg-orient rep) CURRENT=2; _fg_orient_completion
    """,
    "fish": """
        fg-orient completion fish | source
        complete -C 'fg-orient adjust --qui'; complete -C 'fg-orient rep'
    """,
}
OPTIONS = {"zsh": ("-f", "-c"), "fish": ("--no-config", "-c")}


@pytest.mark.slow
@pytest.mark.parametrize("shell", sorted(OFFERED))
def test_other_shells_complete_commands_and_options(shell: str, repository: Path, tmp_path: Path) -> None:
    found = shutil.which(shell)
    if found is None:
        pytest.skip(f"no {shell} on the path")
    program = tmp_path / "bin" / "fg-orient"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nPYTHONPATH={repository} exec {sys.executable} -m fg_orient "$@"\n', "utf-8")
    program.chmod(0o755)
    environment = {**os.environ, "PATH": f"{program.parent}:{os.environ['PATH']}", "HOME": str(tmp_path)}
    done = subprocess.run(
        [found, *OPTIONS[shell], OFFERED[shell]], capture_output=True, text=True, timeout=600, env=environment
    )
    assert done.returncode == 0, done.stderr
    for offered in ("--quiet", "progress", "replay", "report", "reproduce", "Repeat a run"):
        assert offered in done.stdout
    for other in ("--json", "doctor", "adjust"):
        assert other not in done.stdout


def test_completion_of_shells(run: Any) -> None:
    assert run("completion", "zsh").stdout.startswith("#compdef fg-orient\n")
    assert run("completion", "fish").stdout.startswith("complete --command fg-orient ")
    ended = run("completion", "tcsh")
    assert ended.code == 2 and "choose one of bash, zsh, fish" in ended.stderr


def test_refused_log_is_an_input_error(tmp_path: Path) -> None:
    (tmp_path / "x").write_text("{}", encoding="utf-8")
    with pytest.raises(InputError):
        LogFile(tmp_path / "x")
    assert app is application
