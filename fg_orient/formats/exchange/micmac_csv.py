"""Multi-image tie points of MicMac: a folder with one table ``PMUL-IMAGE.csv`` per image, columns Pt.x, Pt.y, Id.

Pt.x is the sample and Pt.y the line; image points of the same Id in several tables are one tie point. Whole numbers
are centres of pixels according to MicMac's description; tie points alone cannot confirm it.
"""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.formats.atomic import write_lines
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.exchange.text import TextLines, make_folder, require_once
from fg_orient.formats.exchange.ties import tie_survey
from fg_orient.formats.registry import Format, Holds, Settings
from fg_orient.model.errors import InputError

Array = npt.NDArray[np.float64]

HEADER: Final = "Pt.x,Pt.y,Id"
PREFIX: Final = "PMUL-"
#: Whole numbers are exact in double precision up to this.
_EXACT: Final = 2.0**53


def read_image(path: str | Path) -> tuple[Array, npt.NDArray[np.int64]]:
    """Pixels (n, 2), line and sample, and ids (n,) of the table of one image, plain or compressed by gzip.

    InputError if the file cannot be read, or with the first faulty line.
    """
    path = Path(path)
    try:
        raw = path.read_bytes()
        text = (gzip.decompress(raw) if raw[:2] == b"\x1f\x8b" else raw).decode("utf-8-sig")
    except (OSError, EOFError, zlib.error) as error:
        raise InputError.of("ties.unreadable", file=path.name, value=error) from None
    except UnicodeDecodeError as error:
        raise InputError.of("ties.not_text", file=path.name, place=f"byte {error.start}") from None
    lines = TextLines(path, text.replace("\r\n", "\n").rstrip("\n"))
    needed = f"the columns {HEADER}, numbers with a whole Id"
    if lines.lines[0].strip() != HEADER:
        lines.refuse(1, needed)
    rows = lines.numbers([(n, line.split(",")) for n, line in enumerate(lines.lines[1:], start=2)], 3, needed)
    ids = rows[:, 2]
    for k in np.flatnonzero((ids != np.floor(ids)) | (np.abs(ids) > _EXACT))[:1]:
        lines.refuse(int(k) + 2, needed)
    require_once(ids, "point", path.name, lambda k: (f"line {k + 2}", int(ids[k])))
    return rows[:, 1::-1].copy(), ids.astype(np.int64)


def image_of(path: Path) -> str:
    """Name of the image of a table; InputError if the file is not named PMUL-IMAGE.csv."""
    name = path.name.removesuffix(".gz")
    if not (name.startswith(PREFIX) and name.endswith(".csv") and len(name) > len(PREFIX) + 4):
        raise InputError.of("micmac.name", file=path.name, value=path.name)
    return name.removeprefix(PREFIX).removesuffix(".csv")


def read(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read all tables of a folder."""
    files = sorted([*paths[0].glob(f"{PREFIX}*.csv"), *paths[0].glob(f"{PREFIX}*.csv.gz")])
    if not files:
        raise InputError.of("ties.missing", file=paths[0], needed=f"a folder with tables {PREFIX}IMAGE.csv")
    images = tuple(image_of(file) for file in files)
    if len(set(images)) < len(images):
        raise InputError.of("micmac.name", file=paths[0], value=next(i for i in images if images.count(i) > 1))
    pixels, numbers = zip(*(read_image(file) for file in files), strict=True)
    ids, point = np.unique(np.concatenate(numbers), return_inverse=True)
    image = np.repeat(np.arange(len(files)), [len(rows) for rows in pixels])
    line, sample = np.concatenate(pixels).T
    return tie_survey(images, tuple(map(str, ids.tolist())), image, point, line, sample)


def write(survey: Survey, paths: tuple[Path, ...], settings: Settings) -> None:
    """Write a table for each image; points get numbers from 0 unless their ids are such."""
    make_folder(paths[0])
    numbers = [name if name == str(int(name)) else "" for name in survey.ids if name.isascii() and name.isdigit()]
    names = survey.ids if len(numbers) == len(survey.ids) and all(numbers) else tuple(map(str, range(len(survey.ids))))
    o = survey.observed
    for k, image in enumerate(survey.images):
        own = np.flatnonzero(o.image == k)
        cells = zip(o.sample[own].tolist(), o.line[own].tolist(), o.point[own].tolist(), strict=True)
        rows = [f"{x!r},{y!r},{names[p]}" for x, y, p in cells]
        write_lines(paths[0] / f"{PREFIX}{image}.csv", [HEADER, *rows])


FORMAT = Format(
    name="micmac-ties",
    title="MicMac multi-image tie points (folder of PMUL-*.csv)",
    files=("tie points",),
    first_pixel=(0.0, 0.0),
    pixel_axes="Pt.x sample, Pt.y line (pixels)",
    holds=frozenset({Holds.IMAGE, Holds.IMAGES, Holds.NUMBERS, Holds.TIES}),
    read=read,
    write=write,
    evidence="230 218 image points of a SPOT 7 pair published with MicMac; the pixel origin is by description",
)
