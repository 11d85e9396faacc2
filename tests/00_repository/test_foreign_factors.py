"""If a package ``factors`` is not fg_orient's, the error names file, owner and remedy, and none of it runs.

Each situation is built from files as pip leaves them; an interpreter of its own imports fg_orient there.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from fg_orient import __version__

pytestmark = pytest.mark.behaviour

WHEEL = f"dist/fg_orient-{__version__}-py3-none-any.whl"
#: What ``import fg_orient`` needs.
PARTS = (
    "__init__.py",
    "model/__init__.py",
    "model/public.py",
    "model/installation.py",
    "model/errors.py",
    "model/messages",
)


def write(file: Path, text: str = "") -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text, "utf-8")


def dist_info(site: Path, name: str, version: str, files: list[str], direct_url: object = None) -> None:
    """Write the records of an installed distribution."""
    folder = site / f"{name.replace('-', '_')}-{version}.dist-info"
    write(folder / "METADATA", f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    write(folder / "RECORD", "".join(f"{file},,\n" for file in files))
    if direct_url is not None:
        write(folder / "direct_url.json", json.dumps(direct_url))


def copy_packages(repository: Path, site: Path) -> None:
    for part in PARTS:
        source, target = repository / "fg_orient" / part, site / "fg_orient" / part
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, target)
    write(site / "factors" / "__init__.py", (repository / "factors" / "__init__.py").read_text("utf-8"))
    write(site / "factors" / "_contract.py")


@pytest.fixture
def site(repository: Path, tmp_path: Path) -> Path:
    """Return a folder with fg_orient as pip installs it from a wheel."""
    folder = tmp_path / "site"
    copy_packages(repository, folder)
    files = ["fg_orient/__init__.py", "factors/__init__.py", "factors/_contract.py"]
    dist_info(folder, "fg-orient", __version__, files, {"url": (tmp_path / WHEEL).as_uri(), "archive_info": {}})
    return folder


def imported(
    *path: Path, environment: dict[str, str] | None = None, command: str = ""
) -> subprocess.CompletedProcess[str]:
    """Import fg_orient with these folders before all others on the search path."""
    before = f"import sys; sys.path[:0] = {[str(p) for p in path]!r}; sys.argv = [{command!r}]"
    code = f"{before}; import fg_orient; print('good')"
    return subprocess.run([sys.executable, "-c", code], cwd=path[0], env=environment, capture_output=True, text=True,
                          timeout=60)  # fmt: skip


def refusal(*path: Path, environment: dict[str, str] | None = None) -> str:
    """Return the line by which fg_orient refuses to be imported."""
    done = imported(*path, environment=environment)
    assert done.returncode == 1 and "RUN" not in done.stdout
    last = done.stderr.splitlines()[-1]
    assert last.startswith("ImportError: ")
    return last.removeprefix("ImportError: ")


def reinstall(tmp_path: Path) -> str:
    return f"pip install --force-reinstall --no-deps {tmp_path / WHEEL}"


def test_our_own_is_accepted(site: Path, tmp_path: Path) -> None:
    assert imported(site).stdout == "good\n"
    linked = tmp_path / "linked"
    linked.mkdir()
    (linked / "fg_orient").symlink_to(site / "fg_orient", target_is_directory=True)
    assert imported(linked, site).stdout == "good\n"


@pytest.mark.parametrize("content", ["", "import pandas_of_another\n", "raise SystemExit(0)\n"])
def test_overwritten_by_another_distribution(site: Path, tmp_path: Path, content: str) -> None:
    """If another distribution overwrites our ``__init__``, the error names it and both commands in their order.

    Uninstalling the other distribution removes the file, so fg_orient must be reinstalled afterwards.
    """
    write(site / "factors" / "__init__.py", content)
    dist_info(site, "factors", "0.1.1", ["factors/__init__.py", "factors/models.py"])
    text = refusal(site)
    assert text.startswith(f"{site / 'factors' / '__init__.py'}: ") and "the distribution factors 0.1.1" in text
    assert f"pip uninstall factors, and then {reinstall(tmp_path)}, in this order" in text


def test_the_command_ends_with_one_line(site: Path) -> None:
    write(site / "factors" / "__init__.py")
    done = imported(site, command=str(site / "bin" / "fg-orient"))
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1 and done.stderr.startswith(f"error: {site / 'factors'}")


def test_file_gone_with_another_distribution(site: Path, tmp_path: Path) -> None:
    """If our ``factors/__init__.py`` is missing, the error names the file and ends with the command to reinstall."""
    (site / "factors" / "__init__.py").unlink()
    leftover = tmp_path / "script" / "factors"
    leftover.mkdir(parents=True)
    for path in ((site,), (leftover.parent, site)):
        text = refusal(*path)
        assert text.startswith(f"{site / 'factors' / '__init__.py'}: ") and text.endswith(reinstall(tmp_path))
    shutil.rmtree(site / "factors")
    assert refusal(site).endswith(reinstall(tmp_path))


def test_leftover_folder_without_init_does_no_harm(site: Path, tmp_path: Path) -> None:
    (tmp_path / "script" / "factors" / "__pycache__").mkdir(parents=True)
    assert imported(tmp_path / "script", site).stdout == "good\n"


def test_file_of_the_user_beside_the_script(site: Path, tmp_path: Path) -> None:
    file = tmp_path / "script" / "factors.py"
    write(file, "print('RUN')\n")
    text = refusal(file.parent, site)
    assert text.startswith(f"{file}: ") and str(site / "factors") in text
    assert "give the file a name" in text and "my_factors.py" in text
    file.rename(file.with_name("my_factors.py"))
    assert imported(file.parent, site).stdout == "good\n"


def test_script_of_the_user_that_has_the_name(site: Path, tmp_path: Path) -> None:
    """A user's script ``factors.py`` runs once, and the import error names it.

    Without the check fg_orient would import the script, and it would run twice.
    """
    script = tmp_path / "factors.py"
    write(script, f"import sys; sys.path.append({str(site)!r}); print('RUN'); import fg_orient\n")
    done = subprocess.run([sys.executable, "-S", script], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout) == (1, "RUN\n")
    assert f"ImportError: {script}: this file hides" in done.stderr


@pytest.mark.parametrize("old_copy", [False, True])
def test_folder_of_the_user(repository: Path, site: Path, tmp_path: Path, old_copy: bool) -> None:
    """A user's folder ``factors`` is named with the remedy to rename it, even if it is an old copy of ours."""
    folder = tmp_path / "script" / "factors"
    text = (repository / "factors" / "__init__.py").read_text("utf-8") if old_copy else "print('RUN')\n"
    write(folder / "__init__.py", text)
    text = refusal(folder.parent, site)
    assert text.startswith(f"{folder}: ") and "rename or remove the folder" in text


def test_folder_on_pythonpath(site: Path, tmp_path: Path) -> None:
    write(tmp_path / "other" / "factors" / "__init__.py", "print('RUN')\n")
    text = refusal(tmp_path / "other", site, environment={"PYTHONPATH": str(tmp_path / "other")})
    assert f"remove {tmp_path / 'other'} from PYTHONPATH" in text


@pytest.mark.parametrize("editable", [False, True])
def test_another_distribution_that_is_found_first(site: Path, tmp_path: Path, editable: bool) -> None:
    """If another distribution is found first, the error names it and does not ask to reinstall fg_orient.

    Our files still exist then, for example behind an editable installation.
    """
    first = tmp_path / "first"
    write(first / "src" / "factors" / "__init__.py", "print('RUN')\n")
    if editable:
        dist_info(first, "Other_Factors", "2.0", [], {"url": first.as_uri(), "dir_info": {"editable": True}})
        text = refusal(first / "src", first, site)
    else:
        dist_info(first / "src", "Other_Factors", "2.0", ["factors/__init__.py"])
        text = refusal(first / "src", site)
    assert "the distribution Other_Factors 2.0 hides" in text and "pip uninstall Other_Factors, or" in text
    assert "force-reinstall" not in text


@pytest.mark.parametrize(
    ("direct_url", "source"),
    [
        (None, "fg-orient"),
        ({"url": "https://host/fg%20orient.whl", "archive_info": {}}, "https://host/fg%20orient.whl"),
        ({"url": "file:///a%20b/fg_orient", "dir_info": {}}, "'/a b/fg_orient'"),
        ({"url": "https://host/r", "vcs_info": {"vcs": "git", "commit_id": "12ab"}}, "git+https://host/r@12ab"),
    ],
)
def test_reinstalled_from_where_it_came(site: Path, direct_url: object, source: str) -> None:
    write(site / "factors" / "__init__.py")
    shutil.rmtree(site / f"fg_orient-{__version__}.dist-info")
    dist_info(site, "fg-orient", __version__, [], direct_url)
    assert refusal(site).endswith(f"pip install --force-reinstall --no-deps {source}")


def test_other_version(site: Path, tmp_path: Path) -> None:
    write(site / "factors" / "__init__.py", "FG_ORIENT_FACTORS = '0.0.9'\n")
    text = refusal(site)
    assert f"belongs to fg_orient 0.0.9, the other packages to {__version__}" in text and text.endswith(
        reinstall(tmp_path)
    )


def test_source_tree_is_restored_not_installed(repository: Path, tmp_path: Path) -> None:
    copy_packages(repository, tmp_path / "tree")
    write(tmp_path / "tree" / "factors" / "__init__.py")
    dist_info(
        tmp_path, "fg-orient", __version__, [], {"url": (tmp_path / "tree").as_uri(), "dir_info": {"editable": True}}
    )
    assert "git checkout factors" in refusal(tmp_path / "tree", tmp_path)


def test_remains_of_an_interrupted_installation_do_not_disturb(site: Path) -> None:
    write(site / "factors" / "__init__.py")
    (site / "~actors-1.0.dist-info").mkdir()
    assert "force-reinstall" in refusal(site)


def test_doctor_warns_of_a_file_with_two_owners(site: Path) -> None:
    """``shared_file`` names another distribution that contains our ``__init__``, although the import still succeeds.

    Uninstalling the other distribution would remove the file.
    """
    code = "from fg_orient.model.installation import shared_file; print(shared_file() or '', end='')"
    for expected in ("", f"{site / 'factors' / '__init__.py'}: the distribution factors 0.1.1 has this file too"):
        text = f"import sys; sys.path.insert(0, {str(site)!r}); {code}"
        done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr
        assert done.stdout.startswith(expected) and bool(done.stdout.strip()) == bool(expected)
        dist_info(site, "factors", "0.1.1", ["factors/__init__.py"])
