"""Each option is declared once and reachable from the project file, the command line and Python."""

from __future__ import annotations

import dataclasses
import inspect
import os
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import fg_orient as fg
import fg_orient.orientation.run
from fg_orient.formats.exchange.survey import no_image_points
from fg_orient.formats.points import no_points
from fg_orient.formats.schema import ProjectFile, validate
from fg_orient.model.block import WithheldCoordinates
from fg_orient.model.declaration import Names, Option, Three, declared
from fg_orient.model.errors import InputError
from fg_orient.model.options import Options, Reading
from fg_orient.model.parameters import with_options
from fg_orient.simulate.options import BlockOptions, MixedOptions, ZonguldakOptions
from tests.support.command import in_process

ALL = declared(Options, Reading)
BLOCK = fg.Block("b", (), no_points(Path("b")).points, no_image_points(), WithheldCoordinates())


def other(option: Option) -> Any:
    """Return a value that is not the default."""
    if option.words:
        return next(word for word in option.words if word != option.default)
    within = option.within or (0.25, 0.5)
    return {bool: not option.default, int: within[1], float: within[1], Three: (1.0, 2.0, 3.0),
            Names: ("one", "two"), str: "other"}[option.kind]  # fmt: skip


def typed(option: Option, value: Any) -> list[str]:
    """Return the option as it is typed on the command line."""
    if option.kind is bool:
        return [option.flag if value else f"--no-{option.flag[2:]}"]
    return [option.flag + ("-of" if option.usual else ""),
            ",".join(map(str, value)) if isinstance(value, tuple) else str(value)]  # fmt: skip


def read(values: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Return the options of a project file with these entries."""
    content = {
        "schema": 1, "name": "n", "images": [{"id": "a", "metadata": "a.DIM"}],
        "points": {"file": "p", "crs": "EPSG:4979"}, "observations": {"file": "o"}, **values,
    }  # fmt: skip
    found = validate(content, "project.toml", ProjectFile)
    return found.values_of(Options) | found.values_of(Reading)


def given_on_the_command_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, *words: str) -> dict[str, Any]:
    """Return the options that ``adjust`` passes to the run."""
    given: dict[str, Any] = {}

    def run_project(*arguments: Any, options: dict[str, Any], **more: Any) -> None:
        given.update(options)
        raise InputError.of("options.value", place="stopped", expected="nothing")

    monkeypatch.setattr(fg_orient.orientation.run, "run_project", run_project)
    monkeypatch.setattr("fg_orient.formats.project.require_files", lambda *arguments, **more: Options())
    project = tmp_path / "project.toml"
    project.touch()
    ended = in_process("adjust", project, *words)
    assert ended.code == 2 and "stopped" in ended.stderr, ended.stderr
    return given


@pytest.mark.behaviour
@pytest.mark.parametrize("name", ALL)
def test_the_project_file_has_every_option(name: str) -> None:
    option = ALL[name]
    value = other(option)
    entry = list(value) if isinstance(value, tuple) else value
    assert read({option.group.table: {name: entry}}) == {n: o.default for n, o in ALL.items()} | {name: value}


@pytest.mark.behaviour
def test_the_command_line_has_every_option(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    values = {name: other(option) for name, option in ALL.items()}
    words = [word for name, option in ALL.items() for word in typed(option, values[name])]
    given = given_on_the_command_line(monkeypatch, tmp_path, *words)
    assert given == values | {"eop_set": str(values["eop_set"])}, "a set may have a name, so it is text here"
    assert given_on_the_command_line(monkeypatch, tmp_path) == {}, "what is not typed replaces nothing"
    usual = given_on_the_command_line(monkeypatch, tmp_path, "--variance-components")
    assert usual == {"variance_components": ("image", "position", "height")}


@pytest.mark.behaviour
@pytest.mark.parametrize("name", declared(Options))
def test_python_has_every_option(name: str) -> None:
    value = other(ALL[name])
    assert getattr(with_options(BLOCK, "adjust", **{name: value}).options, name) == value
    with pytest.raises(InputError) as caught:
        fg.adjust(BLOCK, **{name: object()})
    assert caught.value.problems[0].option == name


@pytest.mark.behaviour
def test_names_that_are_no_options_are_refused_with_the_nearest() -> None:
    with pytest.raises(TypeError, match=r"adjust\(\) has no option 'robust_scal'; did you mean 'robust_scale'"):
        fg.adjust(BLOCK, robust_scal="mad")
    with pytest.raises(TypeError, match=r"read_project\(\) has no option 'eopset'; did you mean 'eop_set'"):
        fg.read_project("project.toml", eopset=3)
    with pytest.raises(TypeError, match="known: eop_set, look_polynomial"):
        fg.adjust(BLOCK, zzz=1)


@pytest.mark.behaviour
def test_options_replace_those_of_the_block_and_arguments_replace_both() -> None:
    block = dataclasses.replace(BLOCK, options=Options(eop_set=3, gnc=True))
    with pytest.raises(InputError) as caught:  # gnc of the argument, needs a loss
        fg.adjust(block, options=Options(eop_set=4), gnc=True)
    assert caught.value.problems[0].code == "adjust.gnc"
    with pytest.raises(InputError) as caught:
        fg.adjust(block, options=Options(backend="schur", solver="qr"), gnc=False)
    assert caught.value.problems[0].code == "adjust.solver_dense", "the block's gnc is gone"


@pytest.mark.repository
def test_the_reference_page_is_made_from_the_declaration(repository: Path) -> None:
    """The reference page of the options is the output of ``python docs/options.py`` and has a row for each flag."""
    made = runpy.run_path(str(repository / "docs" / "options.py"))
    assert made["PAGE"].read_text("utf-8") == made["page"](Options, Reading)
    assert all(f"| `{name}` | `{option.flag}`" in made["PAGE"].read_text("utf-8") for name, option in ALL.items())


@pytest.mark.repository
@pytest.mark.parametrize("record", [Options, Reading, ZonguldakOptions, BlockOptions, MixedOptions])
def test_every_default_is_allowed_and_documented(record: type) -> None:
    text = inspect.getdoc(record) or ""
    for name, option in declared(record).items():
        assert option.allows(option.default) and option.help.endswith(".")
        assert f"\n{name} : " in text and option.help in text
    assert text.count("Parameters\n----------") == 1


@pytest.mark.repository
def test_flags_are_different() -> None:
    """No two options have the same flag. Flags have no units, so that two names could become one flag."""
    for records in ((Options, Reading), (ZonguldakOptions,), (BlockOptions,), (MixedOptions,)):
        flags = [option.flag for option in declared(*records).values()]
        assert len(set(flags)) == len(flags)


#: Adds one field to the source of the declaration, and looks for it everywhere.
ONE_EDIT = """
import importlib.util, runpy, sys, types
spec = importlib.util.find_spec("fg_orient.model.options")
source = open(spec.origin, encoding="utf-8").read()
field = "    further: int = option(3, ADJUSTMENT, 'A further option.', within=(1, 9))\\n"
before = "    max_iterations: int"
assert source.count(before) == 1
module = types.ModuleType("fg_orient.model.options")
sys.modules["fg_orient.model.options"] = module
exec(compile(source.replace(before, field + before), spec.origin, "exec"), module.__dict__)

import fg_orient as fg
from tests.support.command import in_process
from tests.support.pinhole import pinhole_block
from fg_orient.formats.schema import ProjectFile, validate
content = {"schema": 1, "name": "n", "images": [{"id": "a", "metadata": "a"}],
           "points": {"file": "p", "crs": "EPSG:4979"}, "observations": {"file": "o"}, "adjustment": {"further": 4}}
print(validate(content, "f", ProjectFile).values_of(fg.Options)["further"])
content["adjustment"]["further"] = 10
try:
    validate(content, "f", ProjectFile)
except fg.InputError as error:
    print(*error.problems)
print(" ".join(in_process("adjust", "--help").stdout.split()).count("A further option; default: 3."))
for call in (fg.Options, lambda **more: fg.adjust(pinhole_block(2, 1, 2)[0], **more)):
    try:
        call(further=0)
    except fg.InputError as error:
        print(error)
open("project.toml", "w").write("schema = 2")
try:
    fg.read_project("project.toml", further=7)  # accepted: all that is refused is the file
except fg.InputError as error:
    print(*(found.place for found in error.problems))
print("| `further` | `--further` | 3 |" in runpy.run_path(sys.argv[1])["page"](fg.Options))
print("further : int" in fg.Options.__doc__)
"""


def run_edited(code: str, repository: Path, folder: Path) -> list[str]:
    """Run code that edits a module before it is imported, and give the lines that it prints."""
    command = [sys.executable, "-c", code, str(repository / "docs" / "options.py")]
    path = {"PYTHONPATH": str(repository), "COLUMNS": "200"}
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=600, env=os.environ | path)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.repository
def test_a_further_option_is_one_edit(repository: Path, tmp_path: Path) -> None:
    refused = "the value of this option is not allowed (found 0); give a whole number from 1 to 9"
    assert run_edited(ONE_EDIT, repository, tmp_path) == [
        "4",
        "f, adjustment.further: the value is not allowed (found 10); give a whole number from 1 to 9",
        "1", *[f"option further: {refused}"] * 2, "schema name images observations", "True", "True",
    ]  # fmt: skip


#: Adds one row to the table of EOP sets, and looks for it everywhere.
ONE_ROW = """
import importlib.util, inspect, runpy, sys, types
spec = importlib.util.find_spec("fg_orient.model.names")
source = open(spec.origin, encoding="utf-8").read()
end = "), start=1))"
assert source.count(end) == 1
module = types.ModuleType("fg_orient.model.names")
sys.modules["fg_orient.model.names"] = module
row = "    EopSet('PUV1', POSITION + VELOCITY, (0, 1)),\\n"
exec(compile(source.replace(end, row + end), spec.origin, "exec"), module.__dict__)

import fg_orient as fg
from tests.support.command import in_process
from fg_orient.model.parameters import chosen_codes, eop_set_number
from fg_orient.studies.comparison.selections import eop_sets
from fg_orient.studies.tables_spot5 import PUBLISHED_SETS
print(chosen_codes(fg.Options(eop_set=21)) == tuple(3 * c + k for c in range(6) for k in (0, 1)))
default = inspect.signature(fg.compare).parameters["eop_sets"].default
print(eop_set_number("puv1"), eop_sets("20-PUV1"), eop_sets(default)[-1])
for wrong in (lambda: fg.Options(eop_set=22), lambda: eop_set_number("PUV9")):
    try:
        wrong()
    except fg.InputError as error:
        print(error)
for command in ("adjust", "compare"):
    print(" ".join(in_process(command, "--help").stdout.split()).count("1-21"))
print(runpy.run_path(sys.argv[1])["page"](fg.Options).count("EOP set, 1-21 or a name"))
print(len(PUBLISHED_SETS))
"""


@pytest.mark.repository
def test_a_further_eop_set_is_one_row(repository: Path, tmp_path: Path) -> None:
    """One row adds an EOP set to options, names, commands and the reference page, but not to published tables."""
    lines = run_edited(ONE_ROW, repository, tmp_path)
    assert lines[:2] == ["True", "21 (20, 21) 21"]
    assert "give a whole number from 1 to 21" in lines[2]
    assert lines[3].endswith("20 PUVA, 21 PUV1")
    assert lines[4:] == ["1", "2", "1", "20"]
