"""Compare a published report with a result. A CSV table contains name, value, and optionally sigma and digits.

``digits`` is the number of significant digits, for values that were printed without their
last zeros. :func:`fg_orient.model.digits.agreement` compares a value with the published
standard deviation; if this is missing, with ours. A standard deviation is compared only
by its digits. Counts must be equal. Angles in degrees are compared modulo 360.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from itertools import permutations, product
from pathlib import Path
from typing import Any, Final

from fg_orient.closerange.job import NONE, Output, Record
from fg_orient.closerange.report import PACKAGE, RECORD_FILE, read_record
from fg_orient.closerange.report_words import significant
from fg_orient.formats.atomic import write_text
from fg_orient.formats.faults import did_you_mean
from fg_orient.formats.tables import require_table
from fg_orient.formats.text_files import sha256_of
from fg_orient.model.digits import MEANING, agreement, last_digit
from fg_orient.model.errors import InputError
from fg_orient.model.installation import versions
from fg_orient.report.page import environment
from fg_orient.result.plain import plain

#: Allowed columns of the table.
LAYOUTS: Final = [("name", "value", *a, *b) for a, b in product(((), ("sigma",)), ((), ("digits",)))]
#: Maximum number of significant digits.
MOST_DIGITS: Final = 17
_ANGLES: Final = ("omega_deg", "phi_deg", "kappa_deg")

Value = tuple[float | None, float | None]


def values_of(record: Record) -> dict[str, Value]:
    """Return values and standard deviations of a result by name.

    Correlations have names like ``camera all k1/k2``.
    """
    out: dict[str, Value] = {name: (record[name], None) for name in ("m0", "redundancy", "unknowns") if name in record}
    parts = [
        ("", record.get("parameters", [])),
        *((f"{f['figure']} ", f["numbers"]) for f in record.get("figures", [])),
    ]
    parts += [(f"camera {c['camera']} ", c["parameters"]) for c in record.get("cameras", [])]
    for photo in record.get("photos", []):
        of, outer = f"photo {photo['photo']} ", photo["exterior"]
        parts.append((of, photo.get("parameters", [])))
        out |= {of + name: (photo[name], None) for name in ("m0", "redundancy") if name in photo}
        out |= zip(
            (f"{of}{axis}0" for axis in "XYZ"),
            zip(outer["centre_m"], outer["sigma_centre_m"], strict=True),
            strict=True,
        )
        sigma = outer.get("sigma_angles_deg") or [None] * 3
        out |= {of + name: (outer[name], s) for name, s in zip(_ANGLES, sigma, strict=True)}
    out |= {of + n["name"]: (n["value"], n["sigma"]) for of, numbers in parts for n in numbers}
    for point in record.get("points", []):
        out |= {f"point {point['id']} {a}_m": (point[f"{a}_m"], point.get(f"sigma_{a}_m")) for a in "xyz"}
    return out | dict(_correlations(record.get("correlations", {"parts": [], "largest": []})))


def _correlations(record: Record) -> Iterator[tuple[str, Value]]:
    """Yield correlations by both names, in both orders: of one photo or camera, and large ones between two."""
    for part in record["parts"]:
        for i, row in enumerate(part["triangle"]):
            for j, rho in enumerate(row):
                for a, b in ((i, j), (j, i)):
                    yield f"{part['of']} {part['names'][a]}/{part['names'][b]}", (rho, None)
    for pair in record["largest"]:
        for one, other in permutations((pair["a"], pair["b"])):
            yield f"{one}/{other}", (pair["correlation"], None)


def run_comparison(folder: Path, path: Path, output: Output = NONE) -> Record:
    """Compare the values of a table with the result of a folder.

    Parameters
    ----------
    folder : Path
        Result folder of a close-range command.
    path : Path
        Table with the columns name and value, optionally sigma and digits.
    output : Output
        Output whose ``report`` is written.

    Returns
    -------
    dict
        ``values``: a row per line of the table; ``counts`` of the verdicts.

    Raises
    ------
    InputError
        The table has errors, which are all listed, or unknown names, which are listed in one error.
    """
    output.require_possible()
    ours, table = values_of(read_record(folder)), require_table(path, LAYOUTS)
    cells, blank = table.cells, [""] * len(table)
    printed, sigma, digits = table.numbers("value")[:, 0], cells.get("sigma", blank), cells.get("digits", blank)
    for name, code, most in (
        ("sigma", "closerange.printed_sigma", math.inf),
        ("digits", "closerange.printed_digits", MOST_DIGITS),
    ):
        if name in table.columns:
            numbers = table.numbers(name, rows=~table.where(name, ""))[:, 0]
            broken = (numbers % 1 > 0.0) & math.isfinite(most)
            table.refuse((numbers <= 0.0) | (numbers > most) | broken, code, name, limit=most)
    table.refuse_repeated(cells["name"], "closerange.printed_twice", "name")
    table.require_valid()
    lost = [name for name in cells["name"] if name not in ours]
    if lost:
        raise InputError.of(
            "closerange.printed_name", file=path, value=", ".join(lost), hint=did_you_mean(lost[0], list(ours))
        )
    lines = zip(cells["name"], cells["value"], sigma, digits, printed.tolist(), strict=True)
    rows = [_compared(*row, *ours[row[0]]) for row in lines]
    record: Record = plain(
        {
            "folder": str(folder),
            "values": rows,
            "counts": {kind: Counter(row["verdict"] for row in rows)[kind] for kind in MEANING},
            "sigma_counts": {kind: Counter(row["sigma_verdict"] for row in rows)[kind] for kind in MEANING},
            "input": [{"file": one.name, "sha256": sha256_of(one)} for one in (path, folder / RECORD_FILE)],
            "command": list(output.command),
            "versions": versions(),
        }
    )
    if output.report is not None:
        shell = environment(PACKAGE)
        shell.filters |= {"significant": significant}
        page = shell.get_template("compare_report.html.j2")
        write_text(output.report, page.render(r=record, verdict=summary(record), problems=[], meaning=MEANING))
    return record | {"page": None if output.report is None else str(output.report)}


def _compared(
    name: str, text: str, sigma: str, digits: str, printed: float, value: float | None, own: float | None
) -> Record:
    """Return the row of the comparison of a value and its standard deviation."""
    turn = 360.0 if name.endswith("_deg") else math.inf
    off = math.nan if value is None else math.remainder(value - printed, turn)
    spread = float(sigma) if sigma else math.nan if own is None else own
    unit = 0.0 if isinstance(value, int) else last_digit(text, int(float(digits)) if digits else None)
    kind = agreement(off, printed, unit, spread)
    of_sigma = None
    if sigma:
        of_sigma = agreement(math.nan if own is None else own - float(sigma), float(sigma), last_digit(sigma))
    return {
        "name": name,
        "published": text,
        "published_sigma": sigma or None,
        "value": value,
        "sigma": own,
        "difference": off,
        "verdict": kind,
        "sigma_verdict": of_sigma,
    }


def summary(record: Record) -> dict[str, Any]:
    """Return the assessment of a comparison: ``kind`` (good, warn), ``title``, ``text``."""
    n, differ = len(record["values"]), record["counts"]["differs"]
    counts = (f"{count} {kind} ({MEANING[kind]})" for kind, count in record["counts"].items() if count)
    sigmas = (f"{count} {kind}" for kind, count in record["sigma_counts"].items() if count)
    texts = [f"Values: {', '.join(counts)}.", f"Standard deviations: {', '.join(sigmas) or 'not given'}."]
    good = not (differ or record["sigma_counts"]["differs"])
    title = "All values agree" if good else f"{differ} of {n} values differ" if differ else "Standard deviations differ"
    return {"kind": "good" if good else "warn", "title": title, "text": texts}
