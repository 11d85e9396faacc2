"""First lines of a close-range report: assessment as sentences, and list of problems."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fg_orient.closerange.assessment import M0, assessed, is_tested, of_m0, tests_of
from fg_orient.closerange.report_words import accuracy_words, significant
from fg_orient.model.errors import findings_of
from fg_orient.model.names import Status
from fg_orient.quality.verdict import sigma0_interval
from fg_orient.report.words import number


def with_status(record: dict[str, Any]) -> dict[str, Any]:
    """Return a record with its status; records of versions before 0.3 have none and are assessed here."""
    return record if "status" in record else assessed(record, tests_of(record))


def problems(record: Mapping[str, Any]) -> list[str]:
    """Return the problems of the result, the worst first, except those that the verdict states."""
    stated = {*_reason(record)}
    return [text for one in findings_of(record) if one.code not in M0 and (text := str(one)) not in stated]


def _reason(record: Mapping[str, Any]) -> list[str]:
    """Return the first doubt of a result that is not trustworthy; the one on m0 has its own sentence."""
    first = findings_of(record)[:1] if record["status"] == Status.NOT_TRUSTWORTHY else ()
    return [str(one) for one in first if one.code not in M0]


def verdict(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return the assessment of the result: ``kind`` (good, warn, bad), ``title``, ``text``."""
    done = "Fitted" if record["kind"] in ("surface", "dlt") else "Adjusted"
    parts = [record] if "m0" in record else record["photos"]
    names = [f"{part['photo'] or 'photo'}: " if len(parts) > 1 else "" for part in parts]
    texts = [name + m0_words({**record, **part}) for name, part in zip(names, parts, strict=True)]
    if record["status"] == Status.NOT_TRUSTWORTHY:
        kind, title = "bad", "not trustworthy"
    elif any(part["m0"] is None for part in parts):
        kind, title = "warn", "unchecked"
    else:
        kind, title = ("warn", "with warnings") if findings_of(record) else ("good", "nothing stands out")
    return {"kind": kind, "title": f"{done}, {title}", "text": [*_reason(record), *texts[:4], *accuracy_words(record)]}


def m0_words(part: Mapping[str, Any]) -> str:
    """Return a sentence on m0 of a record or of a photo: its comparison with 1, or its unit if no sigmas were given."""
    m0 = part["m0"]
    if m0 is None:
        return "Without redundancy nothing was checked: there are no standard deviations."
    if part.get("loss", "none") != "none":
        return f"With the loss {part['loss']} the weighted residuals are no test of the model."
    if part.get("variance_components"):
        return "The standard deviations were estimated from the residuals: m0 is no test of the model."
    if not is_tested(part):
        unit = "metres" if part["kind"] in ("surface", "absolute") else "the unit of the image coordinates"
        return f"m0, the standard deviation of one observation, is {significant(m0)}, in {unit}."
    found = of_m0(part)
    if found:
        return f"{found[0].message}."
    low, high = sigma0_interval(part["redundancy"])
    return (f"The observations fit the model within their standard deviations: m0 is {significant(m0)}, and chance "
            f"leaves it between {number(low, 2)} and {number(high, 2)}.")  # fmt: skip
