"""Choose the reading of ground points that fits the images best; if several fit, ask a question."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from fg_orient.formats.office.candidates import lonlat, possible_crs, scene_box, usual_first
from fg_orient.formats.office.decisions import Choice, Decisions, Question
from fg_orient.formats.office.fit import SAME_PX, Fit, Reading
from fg_orient.formats.office.ground import Triple
from fg_orient.formats.office.stated import named_pairs, stated_crs, titled
from fg_orient.formats.office.table import Table
from fg_orient.geodesy import crs_kind, known_crs
from fg_orient.model.errors import InputError

#: Usual units in the form of the option ``units``.
_USUAL: Final = ("", "H=m", "E=m", "E=m,H=m", "lon=deg", "lon=deg,H=m")


def readings(
    triples: Sequence[Triple], crs: str, labels: Sequence[tuple[str, ...]], fit: Fit, exchange: bool
) -> list[Reading]:
    """List all readings for which more than half of the points lie near the images.

    Parameters
    ----------
    triples : sequence of Triple
        Possible columns of the coordinates of one table.
    crs : str
        Stated CRS; "" to try all CRS of the area.
    labels : sequence of tuples of str
        Possible images for the labels.
    fit : Fit
    exchange : bool
        Whether to try exchanged lines and samples, too.

    Returns
    -------
    list of Reading
        Readings without order of preference.
    """
    box = scene_box(fit.sensors) if fit.sensors else None
    out = []
    for triple in triples:
        codes = [crs] if crs else possible_crs(triple.kind, triple.coordinates, box)
        for code in codes:
            if crs and crs_kind(code) != triple.kind:
                continue
            ecef = fit.in_ecef(code, triple.coordinates)
            if ecef is None or not fit.near(ecef[np.isfinite(ecef).all(axis=1)]):
                continue
            pixels = fit.predicted(ecef)
            for images in labels:
                for exchanged in (False, True) if exchange else (False,):
                    evidence, where = fit.evidence(pixels, images, exchanged)
                    if not fit.sensors:
                        where = np.empty((0, 2))
                    elif not len(where):
                        whole = ecef[np.isfinite(ecef).all(axis=1)]
                        where = lonlat(whole) / 1e-6 if len(whole) else np.empty((0, 2))  # 1e-6 degrees are 0.1 m
                    out.append(Reading(triple, code, images, exchanged, evidence, where))
    return out


def best_reading(
    table: Table, triples: Sequence[Triple], found: list[Reading], fit: Fit, named_pixels: bool, decisions: Decisions
) -> Reading:
    """Choose the best reading and list its assumptions.

    Raises
    ------
    InputError
        No reading fits, or several fit and the question has no answer.
    """
    if not found:
        kinds = ", ".join(sorted({triple.kind for triple in triples}))
        raise InputError.of("office.nowhere", file=table.file, place=table.sheet.name, option="crs", value=kinds)
    found = titled(table, found, decisions)
    found = _distinct(sorted(found, key=_preference))
    believable = [one for one in found if one.evidence.believable]
    if not believable:
        best = min(found, key=lambda one: one.evidence.scatter_px)
        raise InputError.of("office.no_fit", file=table.file, place=table.sheet.name, option="columns, crs",
                            value=f"{best.triple.words(table)} in {best.crs}: {best.evidence.words()}")  # fmt: skip
    best = _champion(believable)
    left = [one for one in found if one is best or not best.evidence.beats(one.evidence)]
    if any(one.triple.named and not one.exchanged for one in left):
        left = [one for one in left if one.triple.named]
    if named_pixels and any(not one.exchanged for one in left):
        left = [one for one in left if not one.exchanged]
    for option, subject, word in _dimensions(table, fit.marks.labels):
        values = list(dict.fromkeys(word(one) for one in left))
        if len(values) > 1:
            reason = "several fit the images" if not np.isnan(best.evidence.move_px) else "nothing else decides"
            order = {value: next(one for one in left if word(one) == value) for value in values}
            question = Question(
                option, subject, [Choice(v, one.evidence.words()) for v, one in order.items()], False, reason
            )
            choice = decisions.settle(question, table.file)
            left = [one for one in left if choice is not None and word(one) == choice.value] or left
    chosen = left[0] if best not in left else best
    _list(table, chosen, found, named_pixels, decisions)
    return chosen


def _preference(one: Reading) -> tuple[Any, ...]:
    return not one.triple.named, one.exchanged, one.triple.kind, usual_first(one.crs), one.triple.units not in _USUAL


def _distinct(found: list[Reading]) -> list[Reading]:
    """Return readings that differ in the images; of equal readings, the first one is kept and names the others."""
    out: list[Reading] = []
    for one in found:
        for k, other in enumerate(out):
            same = other.images == one.images and other.exchanged == one.exchanged
            if same and one.predicted.shape == other.predicted.shape and _alike(one, other):
                if one.crs not in (other.crs, *other.same):
                    out[k] = replace(other, same=(*other.same, one.crs))
                break
        else:
            out.append(one)
    return out


def _alike(one: Reading, other: Reading) -> bool:
    if not len(one.predicted):
        return one.crs == other.crs and one.triple is other.triple
    apart = np.abs(one.predicted - other.predicted)
    both = np.isfinite(apart)
    return bool(both.any() and apart[both].max() <= SAME_PX)


def _champion(believable: list[Reading]) -> Reading:
    """Return the reading that no other reading beats. If there are several, the smallest image shift decides."""
    unbeaten = [one for one in believable if not any(other.evidence.beats(one.evidence) for other in believable)]
    if not believable[0].evidence.fewest:
        return (unbeaten or believable)[0]
    return min(unbeaten or believable, key=lambda one: round(one.evidence.move_px, 1))


def _dimensions(table: Table, labels: Sequence[str]) -> list[tuple[str, str, Callable[[Reading], str]]]:
    return [
        ("image", "images of the table", lambda one: named_pairs(labels, one.images)),
        ("columns", f"columns of {table.sheet.title}", lambda one: one.triple.words(table)),
        ("units", f"units of {table.sheet.title}", lambda one: one.triple.units),
        ("columns", "line and sample", lambda one: "exchanged" if one.exchanged else "as named"),
        ("crs", f"CRS of {table.sheet.title}", lambda one: one.crs),
    ]


def _list(table: Table, chosen: Reading, found: list[Reading], named_pixels: bool, decisions: Decisions) -> None:
    """List the assumptions of the chosen reading."""
    seen = not np.isnan(chosen.evidence.move_px)
    figures = chosen.evidence.words()
    by_fit = f"it fits the images best: {figures}" if seen else "its points lie in the images"
    if not chosen.triple.named:
        decisions.note(f"columns of {table.sheet.title}", chosen.triple.words(table), by_fit, "columns")
    else:
        decisions.note(f"columns of {table.sheet.title}", chosen.triple.words(table), "by the headers", "columns")
    if chosen.triple.units not in _USUAL or _units_open(table, chosen.triple):
        units = by_fit if seen else "usual"
        reason = units if _units_open(table, chosen.triple) else "by headers or cells"
        decisions.note(f"units of {table.sheet.title}", chosen.triple.units, reason, "units")
    if chosen.exchanged or not named_pixels:
        words = "exchanged" if chosen.exchanged else "in this order"
        decisions.note("line and sample", words, by_fit, "columns")
    if not (decisions.given.get("crs") or stated_crs(table)):
        same = (
            f"; {len(chosen.same)} more CRS give the same places ({', '.join(chosen.same[:3])})" if chosen.same else ""
        )
        decisions.note("CRS", f"{chosen.crs} ({known_crs(chosen.crs).name})", by_fit + same, "crs")
    if seen:
        others = [one for one in found if one is not chosen]
        next_one = min(others, key=lambda one: (one.evidence.scatter_px, one.evidence.move_px), default=None)
        rest = (
            ""
            if next_one is None
            else f"; next: {next_one.triple.words(table)}, {next_one.crs}, {next_one.evidence.words()}"
        )
        decisions.note("fit before the adjustment", figures, f"{len(chosen.predicted)} image points{rest}")


def _units_open(table: Table, triple: Triple) -> bool:
    return any(k >= 0 and not table.names[k].unit for k in triple.columns)
