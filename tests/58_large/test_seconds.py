"""``seconds`` of ``adjust --json`` against the wall clock of its process, taken apart from the program's own clocks."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from fg_orient.simulate.block import BlockOptions, simulate_block

#: Imports what the command works with and notes when it has, and when the process is about to end: its modules are
#: then unloaded. Registered first, so called last.
CODE = """
import atexit
import sys
import time
from pathlib import Path
sys.path.insert(0, {repository!r})
from fg_orient.cli import main
from fg_orient.cli.adjust import load
load()
start = time.time()
atexit.register(lambda: Path({mark!r}).write_text(repr(time.time() - start)))
main()
"""


def test_total_is_the_wall_clock_without_imports(repository: Path, tmp_path: Path) -> None:
    """A run of some seconds; on a loaded machine both sides grow."""
    project = simulate_block(tmp_path / "block", BlockOptions(rows=3, columns=3, points=12_000))
    mark = tmp_path / "mark"
    code = CODE.format(repository=str(repository), mark=str(mark))
    words = [sys.executable, "-c", code, "adjust", str(project), "--statistics", "basic", "--json"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stderr
    seconds, wall = json.loads(done.stdout)["seconds"], float(mark.read_text())
    assert 0.95 * wall < seconds["total"] < wall, (wall, seconds)
    phases = [value for name, value in seconds.items() if name != "total"]
    assert {"read", "structure", "jit", "solve"} < set(seconds) and min(phases) >= 0.0
    assert 0.95 * seconds["total"] < sum(phases) <= seconds["total"]
