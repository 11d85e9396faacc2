"""Find the columns of image points in a table, and the images that the words of the table name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from fg_orient.formats.office.table import Table, id_column
from fg_orient.formats.office.words import plain
from fg_orient.model.errors import InputError


@dataclass(frozen=True, eq=False)
class ImagePart:
    """Columns of image points: either a pair of columns for each image, or one pair and a column of images.

    Parameters
    ----------
    table : Table
    id : int
    image : int
        Column with the names of images; -1 if ``groups`` names the images.
    pairs : list of (int, int)
        Pairs of columns with line and sample.
    groups : list of str
        Words that name the image of each pair; "" if no words name it.
    named : bool
        Whether the headers distinguish line from sample.
    """

    table: Table
    id: int
    image: int
    pairs: list[tuple[int, int]]
    groups: list[str]
    named: bool


def image_part(table: Table, images: Sequence[str]) -> ImagePart | None:
    """Find the columns of image points of a table; None if the table has no image points."""
    image = table.one("image")
    lines, samples = table.having("line"), table.having("sample")
    named = bool(lines)
    if not lines and not samples:
        x, y = table.having("x"), table.having("y")
        if (
            not x
            or len(x) != len(y)
            or (image is None and len(x) == 1 and not (table.names[x[0]].rest or _about(table, images)))
        ):
            return _unnamed(table, images)
        lines, samples, named = y, x, True
    if len(lines) != len(samples):
        raise InputError.of("office.pairs", file=table.file, place=table.sheet.name, option="columns",
                            value=", ".join(table.headers[k] for k in (*lines, *samples)))  # fmt: skip
    rests = [[table.names[k].rest for k in own] for own in (lines, samples)]
    if len(lines) > 1:
        if sorted(rests[0]) != sorted(rests[1]) or len(set(rests[0])) < len(lines):
            raise InputError.of("office.pairs", file=table.file, place=table.sheet.name, option="columns",
                                value=", ".join(table.headers[k] for k in (*lines, *samples)))  # fmt: skip
        samples = [samples[rests[1].index(rest)] for rest in rests[0]]
    groups = rests[0] if len(lines) > 1 else [rests[0][0] or _about(table, images)]
    return ImagePart(
        table,
        id_column(table),
        -1 if image is None else image,
        list(zip(lines, samples, strict=True)),
        groups,
        named,
    )


def _about(table: Table, images: Sequence[str]) -> str:
    """Return the words that name an image.

    They may be in the sheet, in the text above the header, or in the file.
    """
    for text in (table.sheet.name, table.titles, table.sheet.path.stem):
        if text and match_image(text, images):
            return text
    return ""


def match_image(text: str, images: Sequence[str]) -> str:
    """Return the image whose name is contained in a text, or whose name contains the text; "" if it is not unique."""
    if text in images:
        return text
    own = plain(text.replace(".", " ").replace("_", " ").replace("-", " "))
    bare = {name: plain(name.replace(".", " ").replace("_", " ").replace("-", " ")) for name in images}
    for test in (
        lambda a, b: a == b,
        lambda a, b: bool(a) and f" {a} " in f" {b} ",
        lambda a, b: bool(b) and f" {b} " in f" {a} ",
        lambda a, b: bool(set(a.split()) & _own_words(b, list(bare.values()))),
    ):
        found = [name for name, b in bare.items() if own and test(own, b)]
        if len(found) == 1:
            return found[0]
    return ""


def _own_words(name: str, names: Sequence[str]) -> set[str]:
    """Return the words of a name that no other name contains."""
    others = [set(n.split()) for n in names if n != name]
    return set(name.split()) - set().union(*others)


def _unnamed(table: Table, images: Sequence[str]) -> ImagePart | None:
    """Find image points in a table without usual names, by a column of images or by the sheet's name."""
    image = table.one("image")
    if image is None:
        for k in range(len(table.headers)):
            cells = set(table.texts(k))
            if not table.names[k].key and 0 < len(cells) <= len(images) and all(match_image(c, images) for c in cells):
                image = k
                break
    about = "" if image is not None else _about(table, images)
    if image is None and not about:
        return None
    named = table.one("id")
    free = [k for k in range(len(table.headers)) if k != image and not table.names[k].key]
    ids = named if named is not None else (free[0] if free else -1)
    numeric = [k for k in table.numeric if k not in (ids, image) and not table.names[k].key]
    if ids < 0 or len(numeric) != 2:
        return None
    return ImagePart(table, ids, -1 if image is None else image, [(numeric[0], numeric[1])], [about], False)
