"""Random tables of points vary in columns, names, units, separators, encodings, angles and heights."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from tests.support.office import IMAGES, PLACES, Grid, Place, dms, place, text, write_images, write_ods, write_xlsx

#: Headers by language: id, east, north, height, longitude, latitude, image, line, sample, role, control, check.
_WORDS: Final = {
    "en": "Point ID|Easting|Northing|Height|Longitude|Latitude|Image|Line|Sample|Role|control|check",
    "tr": "Nokta No|Doğu|Kuzey|Yükseklik|Boylam|Enlem|Görüntü|Satır|Sütun|Tür|kontrol|denetim",
    "fr": "N° point|Est|Nord|Altitude|Longitude|Latitude|Image|Ligne|Colonne|Nature|appui|point de contrôle",
    "de": "Punkt-Nr.|Rechtswert|Hochwert|Höhe|Länge|Breite|Bild|Zeile|Spalte|Art|Passpunkt|Kontrollpunkt",
    "es": "Punto|Este|Norte|Cota|Longitud|Latitud|Imagen|Fila|Columna|Tipo|apoyo|chequeo",
}
WORDS: Final = {language: words.split("|") for language, words in _WORDS.items()}
#: Names of ellipsoidal heights.
ELLIPSOIDAL: Final = {"en": "Ellipsoidal height", "tr": "Elipsoidal yükseklik", "fr": "Hauteur ellipsoïdale",
                      "de": "Ellipsoidische Höhe", "es": "Altura elipsoidal"}  # fmt: skip
_UTM: Final = {"tr": "EPSG:32636", "fr": "EPSG:32631", "de": "EPSG:32632", "es": "EPSG:32630", "ie": "EPSG:32629"}
#: Height of the geoid above the ellipsoid, m.
GEOID_M: Final = 41.7


@dataclass
class Written:
    """A random table: its truth, digits, and what a user would state about it."""

    there: Place
    folder: Path
    digits_m: float
    first_pixel: float
    ellipsoidal: bool
    roles: dict[str, str]
    story: list[str] = field(default_factory=list)


def random_table(folder: Path, seed: int) -> Written:
    """Write two images and a random table of their points."""
    rng = np.random.default_rng([2026, seed])
    pick = lambda *values: values[int(rng.integers(len(values)))]  # noqa: E731
    name = pick(*PLACES)
    accurate = rng.random() < 0.3
    moves = ((0.02, -0.05), (0.03, 0.04)) if accurate else tuple(map(tuple, rng.uniform(-15.0, 15.0, (2, 2)).tolist()))
    there = place(name, int(rng.integers(7, 25)), seed, pick(5.0, 60.0, 250.0), moves, pick(0.1, 0.3))
    write_images(folder, there)
    language = {"ie": "en"}.get(name, name) if rng.random() < 0.7 else pick(*WORDS)
    ident, east, north, up, lon, lat, image, line, sample, role, control, check = WORDS[language]
    kind = pick("office", "office", "utm", "utm", "degrees")
    crs = {"office": there.crs, "utm": _UTM[name], "degrees": "EPSG:4979"}[kind]
    values = there.map(crs) if kind != "degrees" else there.lonlath.copy()
    ellipsoidal = rng.random() < 0.75
    values[:, 2] -= 0.0 if ellipsoidal else GEOID_M
    decimal, mark = pick((".", ","), (".", ";"), (",", ";"), (",", "\t"), (".", "|"), (".", "  "), (",", "  "))
    written = Written(there, folder, 1e-3, pick(0.0, 1.0, 0.5), ellipsoidal, {})
    story = written.story
    story += [name, language, crs, f"decimal {decimal} mark {mark!r}", "ellipsoidal" if ellipsoidal else "orthometric"]

    # columns of ground points
    headers = {"id": ident, "e": lon if kind == "degrees" else east, "n": lat if kind == "degrees" else north, "h": up}
    if ellipsoidal and rng.random() < 0.6:
        headers["h"] = ELLIPSOIDAL[language]
    if rng.random() < 0.15 and kind != "degrees":
        headers |= dict(zip("en", pick(("X", "Y"), ("Y", "X")), strict=True))
        story.append(f"east is {headers['e']}")
    elif rng.random() < 0.1:  # the names are wrong
        headers["e"], headers["n"] = headers["n"], headers["e"]
        story.append("names of the axes exchanged")
    columns: dict[str, list[Any]] = {"id": list(there.ids), "e": [], "n": [], "h": []}
    if kind == "degrees":
        form = pick("deg", "dms", "gon", "packed")
        story.append(form)
        for axis, key in enumerate("en"):
            v = values[:, axis]
            letters = {"tr": ("DB", "KG")}.get(language, ("EW", "NS"))[axis]
            plain = {"gon": v / 0.9, "packed": np.array([_packed(x) for x in v])}.get(form, v)
            places = 4 if form == "packed" else 9
            columns[key] = (
                [dms(x, letters) for x in v] if form == "dms" else [_number(x, decimal, places) for x in plain]
            )
        if form == "packed":
            written.digits_m = 5e-3
        if form in ("gon", "packed") and rng.random() < 0.5:
            unit = "gon" if form == "gon" else "ddmmss"
            headers["e"], headers["n"] = f"{headers['e']} ({unit})", f"{headers['n']} ({unit})"
    else:
        unit, factor, places = pick(("m", 1.0, 3), ("m", 1.0, 3), ("m", 1.0, 3), ("km", 1e-3, 6), ("cm", 1e2, 1))
        shown = unit == "cm" or rng.random() < 0.5
        story.append(f"unit {unit} {'named' if shown else 'not named'}")
        grouped = unit == "m" and mark in (";", "\t", "|") and rng.random() < 0.15
        for axis, key in enumerate("en"):
            columns[key] = [_number(x * factor, decimal, places, grouped) for x in values[:, axis]]
        if shown:
            headers["e"], headers["n"] = (f"{headers[k]} {pick('({})', '[{}]', '/ {}').format(unit)}" for k in "en")
    unit, factor, places = pick(("m", 1.0, 3), ("m", 1.0, 3), ("ft", 1.0 / 0.3048, 3), ("cm", 1e2, 1))
    shown = unit == "cm" or rng.random() < 0.5
    story.append(f"heights {unit} {'named' if shown else 'not named'}")
    columns["h"] = [_number(x * factor, decimal, places) for x in values[:, 2]]
    headers["h"] += f" ({unit})" if shown else ""
    if rng.random() < 0.5:
        written.roles = {i: pick("control", "check") for i in there.ids}
        headers["role"], columns["role"] = (
            role,
            [control if written.roles[i] == "control" else check for i in there.ids],
        )
    for extra in range(int(rng.integers(0, 3))):
        headers[f"x{extra}"] = pick("Tarih", "Remark", "Bemerkung", "PDOP", "Datum")
        columns[f"x{extra}"] = [pick("a", "b c", "12.05.2024") if mark != "  " else "abc" for _ in there.ids]
    if len(set(headers.values())) < len(headers):
        headers = {k: h if not k.startswith("x") else f"{h} {k[1:]}" for k, h in headers.items()}
    order = list(columns)
    rng.shuffle(order)
    if rng.random() < 0.7:
        order = ["id", *(k for k in order if k != "id")]
    without = rng.random() < 0.1
    rows: Grid = [] if without else [[headers[k] for k in order]]
    rows += [[columns[k][j] for k in order] for j in range(len(there.ids))]
    story += ["no header" if without else " ".join(rows[0])]

    # image points
    pixels = there.pixels + written.first_pixel
    names = {"line": line, "sample": sample}
    if rng.random() < 0.2:
        names = {"line": "y", "sample": "x"}
    wide = rng.random() < 0.25
    marks: Grid
    if wide:
        marks = [[ident, *(f"{names[a]} {i}" for i in IMAGES for a in ("line", "sample"))]]
        marks += [[i, *(_number(v, decimal, 4) for v in pixels[:, j].ravel())] for j, i in enumerate(there.ids)]
    else:
        labels = pick(IMAGES, ("left.tif", "right.tif"), ("A", "B"))
        order = ["image", "id", "line", "sample"]
        rng.shuffle(order)
        marks = [[{"image": image, "id": ident, **names}[k] for k in order]]
        for k, label in enumerate(labels):
            for j, i in enumerate(there.ids):
                own = {"image": label, "id": i, "line": _number(pixels[k, j, 0], decimal, 4),
                       "sample": _number(pixels[k, j, 1], decimal, 4)}  # fmt: skip
                marks.append([own[key] for key in order])
        story.append(f"images {labels}")
    story.append(" ".join(map(str, marks[0])))
    _save(folder, rows, marks, pick("text", "text", "text", "xlsx", "ods"), mark, decimal, language, rng)
    return written


def _number(value: float, decimal: str, places: int, grouped: bool = False) -> str:
    out = f"{value:,.{places}f}" if grouped else f"{value:.{places}f}"
    return out.replace(",", "_").replace(".", decimal).replace("_", "." if decimal == "," else " ")


def _packed(value: float) -> float:
    """Return the degrees as dddmmss.s."""
    sign, value = np.sign(value), abs(value)
    d = int(value)
    m = int((value - d) * 60.0)
    return float(sign * (d * 10000.0 + m * 100.0 + (value - d - m / 60.0) * 3600.0))


def _save(folder: Path, rows: Grid, marks: Grid, form: str, mark: str, decimal: str, language: str, rng: Any) -> None:
    title: Grid = [["Liste 2024"], []] if rng.random() < 0.3 else []
    if form == "text":
        encoding = ["utf-8", "utf-8-sig", "utf-16", "cp1254" if language == "tr" else "cp1252"][int(rng.integers(4))]
        (folder / "ground.csv").write_bytes(text([*title, *rows], mark).encode(encoding))
        (folder / "measured.txt").write_bytes(text(marks, mark).encode(encoding))
        return
    plain = [[[_float(cell, decimal) for cell in row] for row in grid] for grid in ([*title, *rows], marks)]
    write = write_xlsx if form == "xlsx" else write_ods
    write(folder / f"tables.{form}", Sheet1=plain[0], Sheet2=plain[1])


def _float(cell: str, decimal: str) -> Any:
    bare = cell.replace(" ", "") if decimal == "." else cell.replace(".", "").replace(",", ".")
    try:
        return float(bare)
    except ValueError:
        return cell
