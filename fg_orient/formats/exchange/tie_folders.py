"""Tie points in folders with several files: matches of the Ames Stereo Pipeline, and tables of MicMac.

Interest point matches of the Ames Stereo Pipeline are binary files ``PREFIX-LEFT__RIGHT.match`` of image pairs.

A file begins with two numbers of points (uint64), which are equal. The interest points of
the left image follow, then the points of the right image; the k-th points of both images match. A
record is packed, little-endian. It contains x, y (float32), ix, iy (int32), orientation, scale,
interest (float32), polarity (one byte), octave, scale level (uint32), length of the descriptor
(uint64), and the descriptor (float32 each). x is the column and y is the row; (0, 0) is the centre of
the first pixel.

This layout comes from a description. No file of the program was available, so the format
is unverified. The reader therefore checks conditions that a wrong layout would violate. The two numbers
are equal, a polarity is 0 or 1, pixels are finite and near their rounded values, and no byte remains at
the end.

Multi-image tie points of MicMac are a folder with a table ``PMUL-IMAGE.csv`` for each
image. Its columns are Pt.x, Pt.y, Id.

Pt.x is the sample and Pt.y is the line. Image points with the same Id in several tables
belong to one tie point. According to MicMac's description, whole numbers are centres of
pixels. Tie points alone cannot confirm this.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.formats.atomic import made_folder, outputs, write_bytes, write_lines
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.exchange.text import TextLines, read_packed, require_once
from fg_orient.formats.exchange.ties import matched_survey, pairs_of, tie_survey
from fg_orient.formats.registry import TIES_ONLY, Format, Holds, Settings
from fg_orient.model.errors import InputError

RECORD: Final = np.dtype([
    ("x", "<f4"), ("y", "<f4"), ("ix", "<i4"), ("iy", "<i4"), ("orientation", "<f4"), ("scale", "<f4"),
    ("interest", "<f4"), ("polarity", "u1"), ("octave", "<u4"), ("level", "<u4"), ("length", "<u8"),
])  # fmt: skip
#: Maximum difference of an exact pixel from its whole number, which may be rounded or truncated.
WHOLE: Final = 1.0 + 1e-3
#: In a file name, the text between the prefix and the images, and the text between the two images.
_BEFORE, _BETWEEN = "-", "__"


def read_match(path: str | Path) -> tuple[Array, Array]:
    """Read the matched pixels of one file: left and right (n, 2), line and sample.

    InputError: the file cannot be read, is truncated, or has another layout.
    """
    path = Path(path)
    raw = read_packed(path, "ties.unreadable")
    counts = np.frombuffer(raw[:16], "<u8") if len(raw) >= 16 else np.empty(0, np.uint64)
    if len(counts) < 2 or counts[0] != counts[1] or int(counts.sum()) * RECORD.itemsize > len(raw) - 16:
        raise InputError.of("match.layout", file=path.name, place="counts", value=counts.tolist())
    n = int(counts[0])
    records, end = _records(raw, 2 * n)
    place = np.column_stack([records["y"], records["x"]]).astype(float)
    near = np.column_stack([records["iy"], records["ix"]])
    good = np.isfinite(place).all(axis=1) & (records["polarity"] <= 1)
    good[good] = (np.abs(place[good] - near[good]) < WHOLE).all(axis=1)
    if not good.all() or end != len(raw):
        bad = int(np.flatnonzero(~good)[0]) if not good.all() else 2 * n
        value = records[bad].tolist() if bad < 2 * n else f"{len(raw) - end} bytes too many"
        raise InputError.of("match.layout", file=path.name, place=f"interest point {bad + 1}", value=value)
    return place[:n], place[n:]


def _records(raw: bytes, n: int) -> tuple[npt.NDArray[Any], int]:
    """Read n records without their descriptors; return them and the position after them.

    If the file is too short, the records are zeros, and the position is -1.
    """
    heads, at, size = [], 16, RECORD.itemsize
    for _ in range(n):
        if at + size > len(raw):
            return np.zeros(n, RECORD), -1
        heads.append(raw[at : at + size])
        at += size + 4 * int.from_bytes(heads[-1][-8:], "little")
    return np.frombuffer(b"".join(heads), RECORD), at


def write_match(path: str | Path, left: Array, right: Array) -> None:
    """Write matched pixels (n, 2), line and sample, in single precision and without descriptors."""
    both = np.concatenate([left, right])
    records = np.zeros(len(both), RECORD)
    for name, whole, k in (("y", "iy", 0), ("x", "ix", 1)):
        records[name] = both[:, k]
        records[whole] = np.rint(both[:, k])
    records["scale"], records["interest"] = 1.0, 1.0
    counts = np.array([len(left), len(right)], "<u8")
    write_bytes(path, counts.tobytes() + records.tobytes())


def images_of(path: Path) -> tuple[str, str]:
    """Return the names of both images.

    Raise InputError if the file name is not PREFIX-LEFT__RIGHT.match.
    """
    left, between, right = path.stem.partition(_BETWEEN)
    name = left.partition(_BEFORE)[2]
    if path.suffix != ".match" or not (name and between and right) or name == right:
        raise InputError.of("match.name", file=path.name, value=path.name)
    return name, right


def read_matches(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read one file or all files of a folder, and join their matches to tie points."""
    files = sorted(paths[0].glob("*.match")) if paths[0].is_dir() else [paths[0]]
    if not files:
        raise InputError.of("ties.missing", file=paths[0], needed="a folder with files of matches (*.match)")
    images: dict[str, int] = {}
    image, pixels, matches, seen = [], [np.empty((0, 2))], [np.empty((0, 2), np.intp)], 0
    for file in files:
        names, places = images_of(file), read_match(file)
        n = len(places[0])
        for name, place in zip(names, places, strict=True):
            image += [images.setdefault(name, len(images))] * n
            pixels.append(place)
        rows = np.arange(seen, seen + n)
        matches.append(np.column_stack([rows, rows + n]))
        seen += 2 * n
    line, sample = np.concatenate(pixels).T
    return matched_survey(tuple(images), np.array(image, np.intp), line, sample, np.concatenate(matches))


def write_matches(survey: Survey, paths: tuple[Path, ...], settings: Settings) -> None:
    """Write a file for two images, or a folder with a file ``run-A__B.match`` for each image pair."""
    o = survey.observed
    pixels = np.column_stack([o.line, o.sample])
    pairs = pairs_of(o.image, o.point)
    if paths[0].suffix == ".match":
        if len(survey.images) != 2:
            raise InputError.of("match.pair", file=paths[0].name, value=f"{len(survey.images)} images")
        images_of(paths[0])  # refuses a name that the reader would refuse
        rows = pairs.get((0, 1), np.empty((0, 2), np.intp))
        write_match(paths[0], pixels[rows[:, 0]], pixels[rows[:, 1]])
        return
    files = [
        paths[0] / f"run{_BEFORE}{_plain(survey.images, a)}{_BETWEEN}{_plain(survey.images, b)}.match" for a, b in pairs
    ]
    with made_folder(paths[0]), outputs(*files, overwrite=True):
        for file, rows in zip(files, pairs.values(), strict=True):
            write_match(file, pixels[rows[:, 0]], pixels[rows[:, 1]])


def _plain(images: Sequence[str], k: int) -> str:
    """Return the name of an image in a form that a file name can contain."""
    if _BETWEEN in images[k] or images[k].startswith("_"):
        raise InputError.of("match.image", value=images[k])
    return _inside(images[k])


def _inside(image: str) -> str:
    """Return the name of an image.

    Raise InputError if a file with this name could lie outside the folder.
    """
    if "/" in image or "\\" in image:
        raise InputError.of("match.image", value=image)
    return image


FORMAT = Format(
    name="asp-match",
    title="ASP interest point matches (.match)",
    suffixes=(".match",),
    files=("matches",),
    first_pixel=(0.0, 0.0),
    pixel_axes="x column, y row (pixels, single precision)",
    holds=TIES_ONLY,
    read=read_matches,
    write=write_matches,
)

# --- MicMac ----------------------------------------------------------------------------------------

HEADER: Final = "Pt.x,Pt.y,Id"
PREFIX: Final = "PMUL-"
#: Up to this value, whole numbers are exact in double precision.
_EXACT: Final = 2.0**53


def read_image(path: str | Path) -> tuple[Array, npt.NDArray[np.int64]]:
    """Read pixels (n, 2), line and sample, and ids (n,) from the table of one image; gzip is allowed.

    InputError: the file cannot be read, or a line is faulty; the message names the first faulty line.
    """
    path = Path(path)
    try:
        text = read_packed(path, "ties.unreadable").decode("utf-8-sig")
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
    """Return the name of the image of a table.

    Raise InputError if the file name is not PMUL-IMAGE.csv.
    """
    name = path.name.removesuffix(".gz")
    if not (name.startswith(PREFIX) and name.endswith(".csv") and len(name) > len(PREFIX) + 4):
        raise InputError.of("micmac.name", file=path.name, value=path.name)
    return name.removeprefix(PREFIX).removesuffix(".csv")


def read_ties(paths: tuple[Path, ...], settings: Settings) -> Survey:
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


def write_ties(survey: Survey, paths: tuple[Path, ...], settings: Settings) -> None:
    """Write a table for each image.

    If ids are not whole numbers, the points are numbered from 0.
    """
    numbers = [name if name == str(int(name)) else "" for name in survey.ids if name.isascii() and name.isdigit()]
    names = survey.ids if len(numbers) == len(survey.ids) and all(numbers) else tuple(map(str, range(len(survey.ids))))
    o = survey.observed
    tables = [paths[0] / f"{PREFIX}{_inside(image)}.csv" for image in survey.images]
    with made_folder(paths[0]), outputs(*tables, overwrite=True):
        for k, file in enumerate(tables):
            own = np.flatnonzero(o.image == k)
            cells = zip(o.sample[own].tolist(), o.line[own].tolist(), o.point[own].tolist(), strict=True)
            write_lines(file, [HEADER, *(f"{x!r},{y!r},{names[p]}" for x, y, p in cells)])


MICMAC = Format(
    name="micmac-ties",
    title="MicMac multi-image tie points (folder of PMUL-*.csv)",
    files=("tie points",),
    first_pixel=(0.0, 0.0),
    pixel_axes="Pt.x sample, Pt.y line (pixels)",
    holds=frozenset({Holds.IMAGE, Holds.IMAGES, Holds.NUMBERS, Holds.TIES}),
    read=read_ties,
    write=write_ties,
    evidence="230 218 image points of a SPOT 7 pair published with MicMac; the pixel origin is by description",
)
