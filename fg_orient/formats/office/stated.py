"""Find the CRS, datum, zone and images that the words of a table state."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import permutations
from typing import TYPE_CHECKING, Final

from fg_orient.formats.office.decisions import Decisions
from fg_orient.formats.office.image_columns import match_image
from fg_orient.formats.office.table import Table
from fg_orient.geodesy import known_crs
from fg_orient.model.errors import InputError

if TYPE_CHECKING:
    from fg_orient.formats.office.fit import Reading

#: Maximum number of images that are assigned to labels in all orders.
MOST_IMAGES: Final = 4
#: Words in a title or header, and the beginnings of the names of the corresponding CRS.
_DATUMS: Final = (
    (r"\bED ?50\b", ("ED50",)), (r"\bWGS ?84\b", ("WGS 84",)), (r"\b(ITRF ?\d*|TUREF)\b", ("TUREF", "ITRF")),
    (r"\bETRS ?89\b", ("ETRS89",)), (r"\bRGF ?93\b", ("RGF93",)), (r"\bNTF\b", ("NTF",)), (r"\bDHDN\b", ("DHDN",)),
)  # fmt: skip
_CODE: Final = re.compile(r"\bEPSG ?:? ?([0-9]{4,6}(?:\+[0-9]{4,6})?)\b", re.IGNORECASE)
_ZONE: Final = re.compile(r"\b(?:UTM(?: zone)?[ /-]*|zone )([0-9]{1,2}) ?([NS])?\b", re.IGNORECASE)


def stated_crs(table: Table) -> str:
    """Return the CRS whose number a file, its titles or its headers contain; "" if there is no number."""
    if table.sheet.crs:
        return table.sheet.crs
    codes = {found[1] for text in (table.titles, *table.headers) for found in _CODE.finditer(text)}
    return f"EPSG:{codes.pop()}" if len(codes) == 1 else ""


def named_pairs(labels: Sequence[str], images: Sequence[str]) -> str:
    """Return labels with their images in the form of the option ``image``."""
    return ",".join(f"{label}={image}" for label, image in zip(labels, images, strict=True))


def label_images(labels: Sequence[str], images: Sequence[str], given: Mapping[str, str], decisions: Decisions,
                 file: str) -> list[tuple[str, ...]]:  # fmt: skip
    """List the possible assignments of images to the labels of a table.

    If the names decide, there is one assignment. Otherwise all orders are possible.

    Parameters
    ----------
    labels : sequence of str
        Names of images in the table.
    images : sequence of str
        Ids of the images.
    given : mapping of str to str
        Assignments that the user states.
    decisions : Decisions
        Collects the assumption if the names differ.
    file : str
        File of the table, for messages.

    Returns
    -------
    list of tuples of str
        Possible lists of images in the order of ``labels``.

    Raises
    ------
    InputError
        Two labels name the same image, or a label cannot be assigned.
    """
    found = [given.get(label) or match_image(label, images) for label in labels]
    if len(labels) == 1 and not found[0] and len(images) == 1:
        found = [images[0]]
    known = [name for name in found if name]
    for name in known:
        same = [label for label, own in zip(labels, found, strict=True) if own == name]
        if len(same) > 1:
            raise InputError.of("office.same_image", file=file, option="image", value=", ".join(same), image=name)
    if len(known) == len(labels) and len(set(known)) == len(labels):
        changed = [f"{label} = {name}" for label, name in zip(labels, found, strict=True) if label != name]
        if changed:
            decisions.note("images", ", ".join(changed), "by their names", "image")
        return [tuple(found)]
    if len(labels) > len(images):
        unknown = next((label for label, name in zip(labels, found, strict=True) if not name), labels[0])
        raise InputError.of("office.image_unknown", file=file, option="image", value=unknown, known=", ".join(images))
    if len(images) > MOST_IMAGES:
        unknown = next((label for label, name in zip(labels, found, strict=True) if not name), labels[0])
        raise InputError.of("office.image_unknown", file=file, option="image", value=unknown, known=", ".join(images))
    fixed = dict(zip(labels, found, strict=True)) if len(set(known)) == len(known) else {}
    free = [name for name in images if name not in fixed.values()]
    open_labels = [label for label in labels if not fixed.get(label)]
    return [
        tuple(fixed.get(label) or dict(zip(open_labels, order, strict=True))[label] for label in labels)
        for order in permutations(free, len(open_labels))
    ]


def titled(table: Table, found: list[Reading], decisions: Decisions) -> list[Reading]:
    """Select the readings whose datum and zone agree with titles and headers.

    If these name neither, all readings are returned.
    """
    text = " ".join((table.titles, *table.headers)).replace("_", " ")
    for pattern, names in _DATUMS:
        if re.search(pattern, text, re.IGNORECASE):
            own = [one for one in found if known_crs(one.crs).name.startswith(names)]
            if own and len(own) < len(found):
                decisions.note(f"datum of {table.sheet.title}", names[0], "named in the table", "crs")
                found = own
    zone = _ZONE.search(text)
    if zone:
        own = [
            one
            for one in found
            if re.search(rf"UTM zone {int(zone[1])}{(zone[2] or '').upper()}", known_crs(one.crs).name)
        ]
        found = own or found
    return found
