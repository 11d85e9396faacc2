"""Read the image points of tables of unknown form, and determine the origin of their pixel coordinates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from factors.arrays import Array, Mask
from fg_orient.formats.faults import Faults
from fg_orient.formats.office.decisions import Choice, Decisions, Question
from fg_orient.formats.office.fit import Evidence, Fit, Marks, Reading
from fg_orient.formats.office.image_columns import ImagePart
from fg_orient.formats.office.weights import pixel_sigmas
from fg_orient.formats.points import COLUMNS
from fg_orient.model.errors import InputError

#: Coordinates that programs give to the centre of the first pixel.
FIRST_PIXELS: Final = (0.0, 1.0, 0.5)


def read_marks(parts: Sequence[ImagePart]) -> tuple[Marks, Array]:
    """Read the image points of all tables, and their standard deviations (n, 2), px.

    Missing values are nan.
    """
    labels: dict[str, int] = {}
    label, ids, pixels, sigmas = list[int](), list[str](), list[list[float]](), list[list[float]]()
    seen: dict[tuple[int, str], str] = {}
    places: list[tuple[str, str]] = []
    _require_own_ids(parts)
    for part in parts:
        table, faults = part.table, Faults(part.table.file)
        names = table.texts(part.id)
        for (line, sample), group in zip(part.pairs, part.groups, strict=True):
            filled = np.logical_or(table.filled(line), table.filled(sample))
            values = [np.where(filled, table.numbers(k), 0.0) for k in (line, sample)]
            for column, own in zip((line, sample), values, strict=True):
                table.require_numbers(column, own, faults)
            own_sigma = pixel_sigmas(table)
            named = table.texts(part.image) if part.image >= 0 else [group] * len(table)
            for k in np.flatnonzero(filled).tolist():
                if not names[k] or (part.image >= 0 and not named[k]):
                    faults.add("interchange.name_missing", place=table.place(k))
                    continue
                which = labels.setdefault(named[k], len(labels))
                if (which, names[k]) in seen:
                    faults.add("observations.twice", place=table.place(k), first=seen[which, names[k]],
                               value=f"{names[k]} in {named[k] or 'the image'}")  # fmt: skip
                seen[which, names[k]] = table.place(k)
                places.append((table.file, table.place(k)))
                label.append(which)
                ids.append(names[k])
                pixels.append([values[0][k], values[1][k]])
                sigmas.append(own_sigma[k].tolist())
        faults.raise_if_any()
    xy = np.array(pixels, float).reshape(-1, 2)
    marks = Marks(tuple(labels), np.array(label, np.intp), tuple(ids), xy[:, 0], xy[:, 1], tuple(places))
    return marks, np.array(sigmas, float).reshape(-1, 2)


def _require_own_ids(parts: Sequence[ImagePart]) -> None:
    """Refuse two tables of several images each if they have common ids.

    The tables may use the same id for different points.
    """
    before: set[str] = set()
    for part in (part for part in parts if part.image >= 0 and len(set(part.table.texts(part.image))) > 1):
        own = set(part.table.texts(part.id))
        if own & before:
            raise InputError.of("office.shared_ids", file=part.table.file, value=", ".join(sorted(own & before)[:3]))
        before |= own


def first_pixel(
    given: float | None, parts: Sequence[ImagePart], marks: Marks, fit: Fit, reading: Reading | None, crs: str,
    coordinates: Array, decisions: Decisions,
) -> float:  # fmt: skip
    """Determine the coordinate of the first pixel's centre.

    Parameters
    ----------
    given : float or None
        Value that the user states.
    parts : sequence of ImagePart
        Columns of image points. Tables of this program count from 0.
    marks : Marks
    fit : Fit
    reading : Reading or None
        Chosen reading; None if there are no ground points.
    crs : str
        CRS of ``coordinates``.
    coordinates : (n, 3) array
        Coordinates of the ground points.
    decisions : Decisions
        Collects the assumption; if the images are not accurate enough, it collects a question.

    Returns
    -------
    float
        0, 1, 0.5 or the given value.

    Raises
    ------
    InputError
        For every possible value, an image point lies outside its image.
    """
    if given is not None:
        return given
    if all(set(COLUMNS) <= set(part.table.headers) for part in parts):
        decisions.note("first pixel", "0", "these are tables of fg_orient", "first_pixel")
        return 0.0
    images = reading.images if reading is not None else ()
    exchanged = reading is not None and reading.exchanged
    possible = [c for c in FIRST_PIXELS if not outside(marks, images, exchanged, fit.sensors, c).any()]
    if not possible:
        require_inside(marks, images, exchanged, fit.sensors, FIRST_PIXELS[0])
    evidence: dict[float, Evidence] = {}
    if reading is not None and fit.sensors and len(fit.used):
        ecef = fit.in_ecef(crs if not decisions.unanswered else reading.crs, coordinates)
        if ecef is not None:
            pixels = fit.predicted(ecef)
            evidence = {c: fit.evidence(pixels, images, exchanged, c)[0] for c in possible}
    best = min(evidence, key=lambda c: evidence[c].move_px) if evidence else None
    beaten = best is not None and all(c == best or evidence[best].beats(e) for c, e in evidence.items())
    clear = len(possible) == 1 or (beaten and not decisions.unanswered)
    ranked = sorted(possible, key=lambda c: evidence[c].move_px) if evidence else possible
    reason = (
        "other values lie outside the image" if len(possible) == 1 else "the images prove accurate, and it fits best"
    )
    choices = [Choice(f"{c:g}", evidence[c].words() if c in evidence else "") for c in ranked]
    question = Question("first_pixel", "coordinate of the centre of the first pixel", choices, clear,
                        reason if clear else "the images are not accurate enough to tell")  # fmt: skip
    choice = decisions.settle(question, parts[0].table.file, later=True)
    return float(choice.value) if choice is not None else 0.0


def outside(
    marks: Marks, images: Sequence[str], exchanged: bool, sensors: Mapping[str, Any], first_pixel: float
) -> Mask:
    """Find image points outside their images.

    Parameters
    ----------
    marks : Marks
        n image points.
    images : sequence of str
        Image of each label.
    exchanged : bool
        Whether the second coordinate, not the first one, is the line.
    sensors : mapping of str to Sensor
        Images by name. Without images, no point is outside.
    first_pixel : float
        Coordinate of the centre of the first pixel.

    Returns
    -------
    (n,) bool array
    """
    out = np.zeros(len(marks), bool)
    line, sample = (marks.second, marks.first) if exchanged else (marks.first, marks.second)
    for k, name in enumerate(images if sensors else ()):
        own, sensor = marks.label == k, sensors[name]
        for values, size in ((line, sensor.n_lines), (sample, sensor.n_samples)):
            out |= own & ((values < first_pixel - 0.5) | (values > first_pixel + size - 0.5))
    return out


def require_inside(
    marks: Marks, images: Sequence[str], exchanged: bool, sensors: Mapping[str, Any], first_pixel: float
) -> None:
    """Raise InputError if image points lie outside their images."""
    wrong = np.flatnonzero(outside(marks, images, exchanged, sensors, first_pixel)).tolist()
    if wrong:
        faults = Faults(marks.places[wrong[0]][0])
        for k in (k for k in wrong if marks.places[k][0] == faults.file):
            value = f"{marks.first[k]:.10g} {marks.second[k]:.10g}"
            faults.add("office.outside", place=marks.places[k][1], value=value, image=images[marks.label[k]])
        faults.raise_if_any()
