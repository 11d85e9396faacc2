"""Multi-image tie points of MicMac: a folder with one table ``PMUL-IMAGE.csv`` per image, columns Pt.x, Pt.y, Id.

Pt.x is the sample and Pt.y the line; image points of the same Id in several tables are one tie point. That whole
numbers are centres of pixels is MicMac's convention by description: tie points alone cannot decide it.
"""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path
from typing import Final, NoReturn

import numpy as np
import numpy.typing as npt

from fg_orient.formats.atomic import write_lines
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.exchange.text import make_folder
from fg_orient.formats.exchange.ties import tie_survey
from fg_orient.formats.registry import Format, Holds, Settings
from fg_orient.formats.tables import finite
from fg_orient.model.errors import InputError

Array = npt.NDArray[np.float64]

HEADER: Final = "Pt.x,Pt.y,Id"
PREFIX: Final = "PMUL-"
#: Whole numbers are exact in double precision up to this.
_EXACT: Final = 2.0**53


def read_image(path: str | Path) -> tuple[Array, npt.NDArray[np.int64]]:
    """Read the table of one image, plain or compressed by gzip.

    Returns
    -------
    pixels : (n, 2) array
        Line and sample.
    ids : (n,) int array

    Raises
    ------
    InputError
        The file cannot be read, or is faulty: with the first faulty line.
    """
    path = Path(path)
    try:
        raw = path.read_bytes()
        text = (gzip.decompress(raw) if raw[:2] == b"\x1f\x8b" else raw).decode("utf-8-sig")
    except (OSError, EOFError, zlib.error) as error:
        raise InputError.of("ties.unreadable", file=path.name, value=error) from None
    except UnicodeDecodeError as error:
        raise InputError.of("ties.not_text", file=path.name, place=f"byte {error.start}") from None
    lines = text.replace("\r\n", "\n").rstrip("\n").split("\n")
    if lines[0].strip() != HEADER:
        _refuse(path, 1, lines[0])
    records = lines[1:]
    values = finite(",".join(records).split(",")) if records else np.empty(0)
    if values is None or any(record.count(",") != 2 for record in records):
        bad = next(k for k, record in enumerate(records) if record.count(",") != 2 or finite(record.split(",")) is None)
        _refuse(path, bad + 2, records[bad])
    rows = values.reshape(-1, 3)
    odd = np.flatnonzero((rows[:, 2] != np.floor(rows[:, 2])) | (np.abs(rows[:, 2]) > _EXACT))
    if len(odd):
        _refuse(path, int(odd[0]) + 2, records[odd[0]])
    ids, first = np.unique(rows[:, 2], return_index=True)
    if len(ids) < len(rows):
        again = int(np.setdiff1d(np.arange(len(rows)), first)[0])
        raise InputError.of("micmac.twice", file=path.name, place=f"line {again + 2}", value=int(rows[again, 2]))
    return rows[:, 1::-1].copy(), rows[:, 2].astype(np.int64)


def _refuse(path: Path, line: int, text: str) -> NoReturn:
    raise InputError.of("micmac.cells", file=path.name, place=f"line {line}", value=repr(text), header=HEADER)


def image_of(path: Path) -> str:
    """Name of the image of a table.

    Raises
    ------
    InputError
        The file is not named PMUL-IMAGE.csv.
    """
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
