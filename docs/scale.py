"""Write scale.md and its figures: ``python docs/scale.py FOLDER``, a folder of ``fg-orient compare --scale``."""

import json
import shutil
import sys
from pathlib import Path

from fg_orient.studies.comparison.scale_page import page

HERE = Path(__file__).parent
FIGURES = HERE / "_static" / "scale"


def text() -> str:
    """Text of the page from the record that is kept with the figures."""
    record = json.loads((FIGURES / "result.json").read_text("utf-8"))
    return "<!-- made by docs/scale.py from _static/scale/result.json -->\n\n" + page(record, "_static/scale/")


def main(folder: Path) -> None:
    """Copy the figures and the record of a folder, and write the page."""
    FIGURES.mkdir(parents=True, exist_ok=True)
    for path in (folder / "result.json", *sorted(folder.glob("*.svg"))):
        shutil.copyfile(path, FIGURES / path.name)
    (HERE / "scale.md").write_text(text(), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
