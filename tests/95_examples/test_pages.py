"""Every command and code block of README and documentation runs, or this file states why not.

How blocks are written: ``tests/support/pages.py``. A page begins with the files of :func:`prepared` (or none, if it
simulates its own data) and with the names fg, np, block, solution and folder. Each line of a ``sh`` block is an
alternative and may replace what another one wrote.
"""

from __future__ import annotations

import functools
import re
import shutil
from collections import Counter
from collections.abc import Callable
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support import office, page_files, pages, photomodeler, rendered_pair
from tests.support.format_files import FORMAT_FILES, MARKER_FILES, MODEL_FILES
from tests.support.pages import Command, Fence

REPOSITORY = Path(__file__).resolve().parents[2]
PAGES = {
    path.relative_to(REPOSITORY).as_posix(): path
    for path in (*sorted(REPOSITORY.glob("*.md")), *sorted((REPOSITORY / "docs").rglob("*.md")))
    if "api" not in path.relative_to(REPOSITORY).parts and "_build" not in path.parts
}

#: (page or pattern, part of the command or block): why it is not run. Options are read all the same.
NOT_RUN: dict[tuple[str, str], str] = {
    ("README.md", "make "): "makes an environment of its own, minutes; docs/newcomer.sh runs make demo",
    (
        "README.md",
        "env",
    ): "makes an environment of its own, minutes; tests/00_repository/test_packaging.py holds what it installs",
    ("CONTRIBUTING.md", "make "): "the check of every change is made of these",
    ("CONTRIBUTING.md", ".ci/run"): "the check of every change itself",
    (
        "docs/quickstart.md",
        "env",
    ): "makes an environment of its own, minutes; docs/newcomer.sh does so",
    ("docs/geometry.md", "--dem-vertical-crs EPSG:5773"): "needs a grid of PROJ that its wheel does not bring",
    ("README.md", "fg-orient match"): "the twin has no pixels; docs/how-to/two-images.md runs it on rendered ones",
    ("docs/parallel.md", "head:8786"): "needs a cluster of several machines",
    ("docs/parallel.md", "dask scheduler"): "needs a cluster of several machines",
    ("docs/parallel.md", "export "): "names certificates of such a cluster",
    ("docs/compare.md", "--scale"): "takes minutes; tests/65_compare/test_scale.py runs small sizes",
    ("docs/rfm.md", "--data SPOT6_"): "reads a file that is not published; tests/45_rfm reproduces these tables",
}

#: (page, part of the command or block): run by the slow tests only, with the processor seconds it takes.
SLOW: dict[tuple[str, str], float] = {
    ("README.md", "reproduce"): 60,
    ("README.md", "compare PROJECT.toml"): 60,
    ("README.md", "--workers"): 20,
    ("README.md", "--loss tls"): 3,
    ("README.md", "--backend dense"): 3,
    ("README.md", "adjust PROJECT.toml --snoop"): 1,
    ("README.md", "reduce"): 2,
    ("README.md", "replay"): 2,
    ("README.md", "ortho"): 20,
    ("README.md", "--figures"): 20,
    ("README.md", "rpc fit"): 1,
    ("README.md", "--jitter"): 2,
    ("docs/how-to/two-images.md", ""): 8,
    ("README.md", "footprint"): 0.5,
    ("README.md", "--dem-control"): 0.5,
    ("docs/closerange.md", "reproduce"): 15,
    ("docs/closerange.md", "--figures"): 2,
    ("docs/geometry.md", "rpc fit"): 1,
    ("docs/compare.md", "compare"): 60,
    ("docs/rfm.md", "cross_validate("): 4,
    ("docs/ill-conditioning.md", "fg-orient compare"): 40,
    ("docs/ill-conditioning.md", "fg-orient reproduce"): 60,
    ("docs/ill-conditioning.md", "ill_conditioning.py"): 30,
    ("docs/program-as-run.md", "program_as_run.py"): 20,
    ("docs/parallel.md", "workers"): 20,
    ("docs/rectification.md", "reproduce"): 15,
    ("docs/rectification.md", "ortho"): 20,
    ("docs/reproduce.md", "reproduce"): 60,
    ("docs/figures.md", ""): 20,
    ("docs/mixed-blocks.md", ""): 15,
    ("docs/significance.md", "loo"): 12,
    ("docs/tutorials/calibrate.md", "closerange bundle"): 8,
    ("docs/tutorials/stereo.md", "--figures"): 3,
    ("docs/how-to/eop-set.md", "reduce"): 2,
    ("docs/variance-components.md", ""): 15,
    ("docs/terminal.md", ""): 4,
}

#: Pages that another test runs.
RUN_ELSEWHERE = {
    "docs/examples.md": "test_examples.py and 80_claims/test_pleiades_pair.py hold each run against it",
    "docs/how-to/published-report.md": "on files of DBAT: tests/79_closebundle/test_compare_report.py",
    "docs/extending*": "code as plugins outside the package, with more checks: tests/96_extending",
}

#: Folders of docs/_static whose pictures docs/pictures.py draws, and how many there are.
DRAWN = {"concepts": 3, "factor-graph": 4, "tutorials": 5, "examples": 2, "jitter": 1}


def camera_file(folder: Path) -> None:
    """Write camera.toml and uav.toml, the camera files that their page shows."""
    page = "docs/frame-cameras.md"
    for name, word in (("camera", "focal"), ("uav", "convention")):
        text = next(f.text for f in pages.fences(PAGES[page], page) if f.language == "toml" and word in f.text)
        (folder / f"{name}.toml").write_text(text, "utf-8")


#: Files that are written for a page in addition to the prepared files, or instead of them.
OWN_FILES: dict[str, tuple[Callable[[Path], None], ...]] = {
    "README.md": (
        page_files.map_points,
        page_files.photos_and_control,
        office.office_folder,
        *MODEL_FILES,
        *MARKER_FILES,
    ),
    "docs/frame-cameras.md": (camera_file,),
    "docs/quickstart.md": (camera_file, *MARKER_FILES),
    "docs/rpc-commands.md": (page_files.rpc_points,),
    "docs/rectification.md": (page_files.map_points, page_files.outlines),
    "docs/rfm.md": (page_files.gcp_file,),
    "docs/terminal.md": (page_files.two_campaigns,),
    "docs/how-to/photomodeler.md": (photomodeler.write_projects,),
    "docs/how-to/foreign-ties.md": (page_files.foreign_ties,),
    "docs/how-to/refined-rpc.md": (page_files.rpc_project,),
    "docs/how-to/surveyors-table.md": (office.office_folder,),
    "docs/how-to/two-images.md": (rendered_pair.write_example,),
    "docs/closerange.md": (page_files.photos_and_control, page_files.surface_points),
    **{f"docs/formats/{name}.md": write for name, write in FORMAT_FILES.items()},
}

#: Files that are written before a command, because their name had another table before.
BEFORE: dict[tuple[str, str], Callable[[Path], None]] = {("README.md", "rpc refine"): page_files.rpc_points}

#: Pages that begin with their own files and nothing else.
ALONE = {
    "docs/how-to/photomodeler.md",
    "docs/how-to/foreign-ties.md",
    "docs/how-to/refined-rpc.md",
    "docs/how-to/surveyors-table.md",
    "docs/how-to/two-images.md",
    *(f"docs/formats/{name}.md" for name in FORMAT_FILES),
}


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of files to which pages without own data refer."""
    folder = tmp_path_factory.mktemp("pages")
    page_files.satellite_files(folder)
    return folder


def listed(table: dict[tuple[str, str], Any], item: Command | Fence) -> bool:
    """Return whether a command or block is in a table, or is run elsewhere."""
    if any(fnmatchcase(item.page, page) for page in RUN_ELSEWHERE):
        return True
    return any(fnmatchcase(item.page, page) and part in item.text for page, part in table)


@pytest.mark.repository
def test_no_list_names_what_is_no_longer_there() -> None:
    items = [item for name, path in PAGES.items() for fence in pages.fences(path, name) for item in parts(fence)]
    for table in (NOT_RUN, SLOW, BEFORE):
        for page, part in table:
            assert any(fnmatchcase(item.page, page) and part in item.text for item in items), (page, part)
    assert set(OWN_FILES) <= set(PAGES)
    assert all(any(fnmatchcase(name, page) for name in PAGES) for page in RUN_ELSEWHERE)
    assert not set(NOT_RUN) & set(SLOW)


def parts(fence: Fence) -> list[Command | Fence]:
    """Return the parts that run as a whole: a Python block, a command."""
    return [fence] if fence.language in ("python", "toml") else list(pages.commands(fence))


@pytest.mark.repository
@pytest.mark.parametrize("name", PAGES)
def test_options_of_every_command_exist(name: str) -> None:
    for fence in pages.fences(PAGES[name], name):
        for item in parts(fence):
            if isinstance(item, Command) and item.words and item.words[0] == "fg-orient":
                pages.parse_command(item)


@pytest.mark.repository
def test_every_picture_is_small_told_in_words_and_shown() -> None:
    """Each drawn picture is below 150 kB and shown on a page, and each picture has alternative text."""
    shown: set[Path] = set()
    for name, path in PAGES.items():
        for words, target in re.findall(r"!\[(.*?)\]\((\S+?)\)", path.read_text("utf-8"), re.DOTALL):
            picture = (path.parent / target).resolve()
            assert picture.is_file(), (name, target)
            assert len(words.split()) >= 3, (name, target)
            shown.add(picture)
    drawn = [p for folder in DRAWN for p in (REPOSITORY / "docs" / "_static" / folder).iterdir()]
    assert Counter(p.parent.name for p in drawn) == DRAWN
    for picture in drawn:
        assert picture in shown, picture
        assert picture.stat().st_size < 150_000, picture


@pytest.mark.behaviour
@pytest.mark.slow
def test_pictures_are_drawn_again(tmp_path: Path) -> None:
    """``docs/pictures.py`` draws all pictures of the documentation under the same names."""
    ended = pages.run_script(REPOSITORY / "docs" / "pictures.py", tmp_path)
    assert ended.code == 0, ended.stderr
    kept = REPOSITORY / "docs" / "_static"
    drawn = {path.relative_to(tmp_path) for path in tmp_path.rglob("*.svg")}
    assert drawn == {path.relative_to(kept) for folder in DRAWN for path in kept.glob(f"{folder}/*")}


def start(name: str, prepared: Path, folder: Path) -> dict[str, Any]:
    """Fill the folder of a page and return the names with which its code begins."""
    import fg_orient as fg

    names: dict[str, Any] = {"__name__": "page", "fg": fg, "np": np, "folder": folder}
    text = PAGES[name].read_text("utf-8")
    if name not in ALONE and ("fg-orient simulate" not in text or name in OWN_FILES):
        shutil.copytree(prepared, folder, dirs_exist_ok=True)
    for write in OWN_FILES.get(name, ()):
        write(folder)
    if re.search(r"\b(block|solution)\b", "".join(f.text for f in pages.fences(PAGES[name], name))):
        names |= block_and_solution(prepared)
    return names


@functools.cache
def block_and_solution(prepared: Path) -> dict[str, Any]:
    """Return the prepared project as read and adjusted."""
    import fg_orient as fg

    block = fg.read_project(prepared / "project.toml")
    return {"block": block, "solution": fg.adjust(block)}


def run_page(name: str, prepared: Path, folder: Path, *, slow: bool) -> None:
    """Run what the fast or the slow tests run of a page."""

    def take(item: Command | Fence) -> bool:
        if listed(NOT_RUN, item) or (not slow and listed(SLOW, item)):
            return False
        for (page, part), write in BEFORE.items():
            if item.page == page and part in item.text:
                write(folder)
        return True

    pages.run_page(pages.fences(PAGES[name], name), start(name, prepared, folder), REPOSITORY, take)


def with_blocks(*, slow: bool) -> list[str]:
    """Return the pages of which the fast, or only the slow, tests run something."""
    found = []
    for name, path in PAGES.items():
        items = [item for fence in pages.fences(path, name) for item in parts(fence) if not listed(NOT_RUN, item)]
        if items and any(listed(SLOW, item) for item in items) >= slow:
            found.append(name)
    return found


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder that a page is run in, the current one; terminals are 80 columns wide."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    return tmp_path


@pytest.mark.behaviour
@pytest.mark.parametrize("name", with_blocks(slow=False))
def test_page(name: str, prepared: Path, folder: Path) -> None:
    run_page(name, prepared, folder, slow=False)


@pytest.mark.behaviour
@pytest.mark.slow
@pytest.mark.parametrize("name", with_blocks(slow=True))
def test_whole_page(name: str, prepared: Path, folder: Path) -> None:
    run_page(name, prepared, folder, slow=True)
