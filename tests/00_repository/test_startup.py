"""Start-up cost and lazy loading, measured in fresh interpreters."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

IMPORT_BUDGET_S = 0.7
HEAVY = ("gtsam", "numba", "scipy", "pandas", "matplotlib", "rasterio", "pyproj", "erfa", "lxml", "pydantic")


def run(code: str, folder: Path) -> str:
    """Run code in a fresh interpreter of this environment and give what it prints."""
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_import_is_quick(repository: Path) -> None:
    code = "import time; t = time.perf_counter(); import fg_orient; print(time.perf_counter() - t)"
    best = min(float(run(code, repository)) for _ in range(3))
    assert best < IMPORT_BUDGET_S


def test_import_loads_nothing_heavy(repository: Path) -> None:
    code = f"import fg_orient, sys; print([m for m in {HEAVY} if m in sys.modules])"
    assert run(code, repository).strip() == "[]"


def test_help_does_not_import_gtsam(repository: Path) -> None:
    code = (
        "import sys; sys.argv = ['fg-orient', '--help']\n"
        "from fg_orient.cli import main\n"
        "try:\n    main()\nexcept SystemExit as end:\n    assert not end.code, end.code\n"
        "print('LOADED', [m for m in ('gtsam', 'numba') if m in sys.modules])"
    )
    out = run(code, repository)
    assert "adjust" in out
    assert out.strip().endswith("LOADED []")


def test_every_public_name_loads(repository: Path) -> None:
    code = "import fg_orient as fg; print([n for n in fg.__all__ if getattr(fg, n) is None or n not in dir(fg)])"
    assert run(code, repository).strip() == "[]"


def test_unknown_name_is_an_attribute_error(repository: Path) -> None:
    code = "import fg_orient\ntry:\n    fg_orient.nonsense\nexcept AttributeError as e:\n    print(e)"
    assert run(code, repository).strip() == "module 'fg_orient' has no attribute 'nonsense'"
