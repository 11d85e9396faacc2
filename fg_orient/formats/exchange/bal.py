"""Files of "Bundle Adjustment in the Large" (Agarwal et al. 2010).

They contain frame images, tie points and start values, but no control. A file is text, plain or
compressed by gzip or bzip2: number of cameras, points and observations; one observation per line
(camera, point, x, y); nine numbers per camera (rotation vector, translation, f, k1, k2), three
per point; ``fg_orient.formats.exchange.bundle_model`` has the camera model. A block of such a
file counts pixels from the middle of the image: samples are x and lines -y.
"""

from __future__ import annotations

import bz2
import gzip
from pathlib import Path
from typing import Final, NoReturn

import numpy as np

from fg_orient.formats.atomic import require_free_files, write_bytes
from fg_orient.formats.exchange.bundle_model import BalData, bundle_format, frame_model_of
from fg_orient.formats.exchange.text import read_packed, whole
from fg_orient.formats.frame_model import frame_block
from fg_orient.formats.tables import finite
from fg_orient.formats.text_files import sha256_of
from fg_orient.model.block import Block, Source
from fg_orient.model.errors import Finding, InputError

N_CAMERA: Final = 9
#: Unknowns of a camera.
UNKNOWN: Final = (
    "rotation_x", "rotation_y", "rotation_z", "centre_x", "centre_y", "centre_z", "focal", "k1", "k2",
)  # fmt: skip
#: A count above this is that of a damaged file.
LARGEST: Final = 10**9


def read_bal(path: str | Path, *, keep_behind: bool = True) -> Block:
    """Read a file as a block in a local system, with the options to adjust it as the literature does.

    There are no priors and the datum is free; Levenberg-Marquardt; sigma 1 px: the cost is then that of the literature,
    in px^2. Points measured in one image only, once or more, are left out: nothing determines their depth.

    Parameters
    ----------
    path : str or Path
    keep_behind : bool
        Keep points whose start values lie behind one of their cameras. The equation holds there as well, but no
        camera sees backwards. Programs differ: Ceres keeps them. GTSAM's ``GeneralSFMFactor`` counts their residuals
        as zero, so that a cost of GTSAM corresponds to False.

    Raises
    ------
    InputError
        The file cannot be read, is truncated or damaged: with the line of the first fault.
    """
    path = Path(path)
    model = frame_model_of(read_bal_data(path), from_middle=True)
    source = Source(str(path), sha256_of(path))
    return frame_block(model, path.name, (source,), unknowns=UNKNOWN, keep_behind=keep_behind)


def read_bal_data(path: str | Path) -> BalData:
    """Read the numbers of a file into arrays; errors as in :func:`read_bal`."""
    return _parse(read_packed(Path(path), "bal.unreadable"), Path(path).name)


def _parse(raw: bytes, file: str) -> BalData:
    text = raw.decode("ascii", "replace")
    tokens = text.split()
    counts = [whole(token) for token in tokens[:3]]
    m, n_points, n = (count or LARGEST + 1 for count in (*counts, *(None,) * (3 - len(counts))))
    if max(m, n_points, n) > LARGEST:
        raise InputError.of("bal.header", file=file, place="line 1", value=text.split("\n", 1)[0][:60])
    expected = 3 + 4 * n + N_CAMERA * m + 3 * n_points
    if len(tokens) != expected:
        place = f"line {raw.count(10) + 1}"
        raise InputError.of("bal.count", file=file, place=place, value=f"{len(tokens)} numbers", expected=expected)
    values = finite(tokens[3:])
    if values is None:
        _refuse(text, file, next(k for k in range(3, expected) if finite(tokens[k : k + 1]) is None), "bal.number")
    observed = values[: 4 * n].reshape(n, 4)
    limits = np.array([m, n_points])
    bad = np.argwhere((observed[:, :2] < 0) | (observed[:, :2] >= limits) | (observed[:, :2] % 1 != 0))
    if len(bad):
        _refuse(text, file, 3 + 4 * int(bad[0, 0]) + int(bad[0, 1]), "bal.index", last=int(limits[bad[0, 1]]) - 1)
    cameras = values[4 * n : 4 * n + N_CAMERA * m].reshape(-1, N_CAMERA)
    short = np.flatnonzero(cameras[:, 6] <= 0.0)
    if len(short):
        _refuse(text, file, 3 + 4 * n + N_CAMERA * int(short[0]) + 6, "bal.focal")
    index = observed[:, :2].astype(np.intp)
    points = values[-3 * n_points :].reshape(-1, 3).copy()
    return BalData(index[:, 0], index[:, 1], observed[:, 2:].copy(), cameras.copy(), points)


def _refuse(text: str, file: str, wrong: int, code: str, **fields: object) -> NoReturn:
    """Raise InputError for a number, given by its position among all numbers, with its line."""
    for line, row in enumerate(text.split("\n"), start=1):
        cells = row.split()
        if wrong < len(cells):
            raise InputError.of(code, file=file, place=f"line {line}", value=cells[wrong][:60], **fields)
        wrong -= len(cells)
    raise AssertionError("the file contains the number")


def write_bal(path: str | Path, data: BalData, *, overwrite: bool = False) -> None:
    """Write a file with all digits, compressed if its name ends with .gz or .bz2; InputError if it exists."""
    path = Path(path)
    require_free_files(path, overwrite=overwrite)
    seen = zip(data.camera.tolist(), data.point.tolist(), data.xy.tolist(), strict=True)
    lines = [f"{len(data.cameras)} {len(data.points)} {len(data.xy)}"]
    lines += (f"{c} {p} {x!r} {y!r}" for c, p, (x, y) in seen)
    lines += map(repr, data.cameras.ravel().tolist())
    lines += map(repr, data.points.ravel().tolist())
    raw = "\n".join([*lines, ""]).encode()
    if path.suffix == ".gz":
        raw = gzip.compress(raw, mtime=0)
    write_bytes(path, bz2.compress(raw) if path.suffix == ".bz2" else raw)


def _load(paths: tuple[Path, ...]) -> tuple[BalData, list[str], tuple[Finding, ...]]:
    data = read_bal_data(paths[0])
    return data, list(map(str, range(len(data.cameras)))), ()


FORMAT: Final = bundle_format(
    _load, write_bal, name="bal", title="Bundle Adjustment in the Large", files=("bundle",),
    help=__doc__ or "", evidence="the published problem Ladybug 49",
)  # fmt: skip
