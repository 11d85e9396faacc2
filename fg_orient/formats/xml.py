"""Read XML files safely, and read values of given types from their elements.

Metadata files may come from untrusted sources. A file is parsed without network access,
DTD, entities and recovery. It is refused if it contains a DOCTYPE or exceeds a size
limit. Readers request each value by path, unit and type. If a value is missing, doubled,
empty, not a number or in an unknown unit, an :class:`~fg_orient.model.errors.InputError`
names file, line, element, value and remedy.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from decimal import Decimal
from itertools import chain
from typing import Any

import numpy as np
from lxml import etree

from factors.arrays import Array
from fg_orient.formats.columns import finite
from fg_orient.formats.load import load_bytes
from fg_orient.formats.tables import DECIMAL_COMMA
from fg_orient.model.digits import NUMBER
from fg_orient.model.errors import InputError
from fg_orient.model.limits import within_memory

#: Largest allowed number in a metadata file; squares of much larger numbers would overflow.
LARGEST = 1e30
#: Bytes of a parsed document for each of these characters. An element has two "<", an attribute has one "=".
_OBJECTS = {b"<": 200, b"=": 200}

_NOT_FINITE = re.compile(r"[+-]?(?:nan|inf|infinity)", re.IGNORECASE)
_TIME = re.compile(r"([0-9]{4}-[0-9]{2}-[0-9]{2})T([0-9]{2}):([0-9]{2}):([0-9]{2}(?:\.[0-9]+)?)Z?")
# possessive repetition: a malicious prolog cannot make the search slow by backtracking
_DOCTYPE = re.compile(rb"(?:\xef\xbb\xbf)?(?:\s|(?><\?.*?\?>)|(?><!--.*?-->))*+<!DOCTYPE", re.DOTALL | re.IGNORECASE)
_HTML = re.compile(rb"(?:\xef\xbb\xbf)?\s*<(?:!doctype\s+html|html)\b", re.IGNORECASE)
_MAGIC = {
    b"II*\0": "a TIFF image", b"MM\0*": "a TIFF image", b"\0\0\0\x0cjP": "a JPEG 2000 image",
    b"PK\x03\x04": "a zip archive", b"\x1f\x8b": "a gzip file", b"%PDF": "a PDF document",
}  # fmt: skip


@dataclass(frozen=True)
class Quantity:
    """Kind of a number: its units and their factors to SI; ``default`` is used if the file does not name a unit."""

    name: str
    default: str
    factors: dict[str, float]


_TIMES = {
    "s": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "millisecond": 1e-3, "milliseconds": 1e-3,
    "us": 1e-6, "\u00b5s": 1e-6, "\u03bcs": 1e-6, "microsecond": 1e-6, "microseconds": 1e-6,
}  # fmt: skip
_ANGLES = {
    "rad": 1.0, "radian": 1.0, "radians": 1.0, "mrad": 1e-3, "urad": 1e-6, "microrad": 1e-6,
    "deg": math.pi / 180.0, "degree": math.pi / 180.0, "degrees": math.pi / 180.0,
}  # fmt: skip
SECONDS = Quantity("time", "s", _TIMES)
MILLISECONDS = Quantity("time", "ms", _TIMES)
METRES = Quantity("length", "m", {"m": 1.0, "metre": 1.0, "meter": 1.0, "km": 1e3})
METRES_PER_SECOND = Quantity("speed", "m/s", {"m/s": 1.0, "m.s-1": 1.0, "km/s": 1e3})
RADIANS = Quantity("angle", "rad", _ANGLES)
RADIANS_PER_SECOND = Quantity("angular speed", "rad/s", {f"{unit}/s": f for unit, f in _ANGLES.items()})
#: Geographic coordinates are not converted to radians: the records of the readers contain degrees.
DEGREES = Quantity("geographic angle", "deg", {"deg": 1.0, "degree": 1.0, "degrees": 1.0})
PURE = Quantity("pure number", "1", {"1": 1.0, "none": 1.0, "tan": 1.0, "pixel": 1.0})


@dataclass(frozen=True, slots=True)
class XmlNode:
    """XML element with its file. A path consists of names of child elements, joined by "/".

    Methods that read values raise InputError for the first fault. An element may be
    missing or doubled. A text may be empty, of another type, in an unknown unit, out of
    range or not finite.
    """

    element: etree._Element
    file: str

    @property
    def tag(self) -> str:
        """Return the name of the element without its namespace."""
        return etree.QName(self.element).localname

    @property
    def place(self) -> str:
        """Return the line number and the path below the root, for messages."""
        names = [str(a.tag) for a in self.element.iterancestors()][-2::-1]
        return f"line {self.element.sourceline}, {'/'.join([*names, self.tag])}"

    def fault(self, code: str, value: object = "", **fields: object) -> InputError:
        """Make the InputError for a fault of this element."""
        return InputError.of(code, file=self.file, place=self.place, value=value, **fields)

    # --- elements ----------------------------------------------------------------------------

    def maybe(self, path: str) -> XmlNode | None:
        """Return the element at ``path``, or None if it does not exist."""
        node = self
        for name in path.split("/"):
            nodes = list(node.element.iterchildren(name))
            if not nodes:
                return None
            if len(nodes) > 1:
                raise XmlNode(nodes[1], self.file).fault("xml.doubled", f"{len(nodes)} times")
            node = XmlNode(nodes[0], self.file)
        return node

    def one(self, path: str) -> XmlNode:
        """Return the only element at ``path``."""
        node = self.maybe(path)
        if node is None:
            raise self.fault("xml.missing_element", element=path)
        return node

    def every(self, path: str, at_least: int = 1) -> list[XmlNode]:
        """Return all elements at ``path``; only the last name of the path may occur several times."""
        *steps, last = path.split("/")
        parent = self.one("/".join(steps)) if steps else self
        nodes = [XmlNode(e, self.file) for e in parent.element.iterchildren(last)]
        if len(nodes) < at_least:
            raise parent.fault("xml.too_few", f"{len(nodes)} {last}", element=last, at_least=at_least)
        return nodes

    def children(self) -> Iterator[XmlNode]:
        """Return the child elements in the order of the file, without comments."""
        return (XmlNode(e, self.file) for e in self.element.iterchildren("*"))

    def table(self, tag: str, columns: Mapping[str, tuple[Quantity, float, float]], at_least: int = 1) -> Array:
        """Read numbers of all elements ``tag``; each element gives one row.

        Elements without attributes and further children are read together, which is six times
        faster. Other elements are read one by one.

        Parameters
        ----------
        tag : str
        columns : mapping of str to (Quantity, low, high)
            Quantity and range of each child element.
        at_least : int

        Returns
        -------
        (n, k) array
            Numbers in SI units.
        """
        quantities, low, high = zip(*columns.values(), strict=True)
        values = self._plain_numbers(tag, tuple(columns))
        if values is not None:
            values *= [quantity.factors[quantity.default] for quantity in quantities]
        if values is None or len(values) < at_least or not ((values >= low) & (values <= high)).all():
            rows = self.every(tag, at_least)
            values = np.array([[row.one(name).number(*limits) for name, limits in columns.items()] for row in rows])
        return values

    def _plain_numbers(self, tag: str, names: tuple[str, ...]) -> Array | None:
        """Read the numbers (n, k) of n simple elements ``tag`` together.

        The result is None if this element has other children, or if an element is not
        simple. A simple element has exactly the children ``names`` in this order, without
        attributes, and their texts are finite numbers.
        """
        text, n, k = etree.tostring(self.element, with_tail=False), len(self.element), len(names)
        cells = r"\s*".join(rf"<{name}>\s*([^<\s]+)\s*</{name}>" for name in names)
        rows = re.findall(rf"<{tag}>\s*{cells}\s*</{tag}>".encode(), text)
        if len(rows) != n or text.count(b"<") != 2 + n * (2 + 2 * k):  # there are other elements
            return None
        values = finite((b" ".join(rows) if k == 1 else b" ".join(chain.from_iterable(rows))).decode().split())
        return values.reshape(n, k) if values is not None and np.abs(values).max(initial=0.0) <= LARGEST else None

    # --- values ------------------------------------------------------------------------------

    def text(self) -> str:
        """Return the text of an element without children; outer blanks are removed."""
        if len(self.element):
            raise self.fault("xml.not_plain", self.element[0].tag)
        text = (self.element.text or "").strip()
        if not text:
            raise self.fault("xml.empty")
        return text

    def number(self, quantity: Quantity = PURE, low: float = -math.inf, high: float = math.inf) -> float:
        """Return a finite number between ``low`` and ``high``, in the SI unit of ``quantity``."""
        value = self._parse(self.text()) * self._factor(quantity)
        if not low <= value <= high or not math.isfinite(value):
            si = next(unit for unit, factor in quantity.factors.items() if factor == 1.0)
            raise self.fault("xml.out_of_range", self.text(), low=low, high=high, unit="" if si == "1" else f" {si}")
        return value

    def integer(self, low: int, high: int) -> int:
        """Return a whole number between ``low`` and ``high``."""
        value = self.number(PURE, low, high)
        if not value.is_integer():
            raise self.fault("xml.not_whole", self.text())
        return int(value)

    def vector(self, size: int, quantity: Quantity = PURE) -> Array:
        """Return numbers (size,) that are separated by blanks, in the SI unit of ``quantity``."""
        words = self.text().split()
        if len(words) != size:
            raise self.fault("xml.wrong_count", f"{len(words)} numbers", expected=size)
        values = np.array([self._parse(word) for word in words]) * self._factor(quantity)
        if not np.isfinite(values).all():
            raise self.fault("xml.not_finite", self.text())
        return values

    def time(self) -> tuple[np.datetime64, Decimal]:
        """Return the UTC day of an ISO 8601 time, and its exact seconds of the day."""
        text = self.text()
        match = _TIME.fullmatch(text)
        if match is None:
            raise self.fault("xml.not_a_time", text)
        day, hour, minute, second = match.groups()
        try:
            date = np.datetime64(day, "D")
        except ValueError:
            raise self.fault("xml.not_a_time", text) from None
        if int(hour) > 23 or int(minute) > 59 or Decimal(second) >= 60:
            raise self.fault("xml.not_a_time", text)
        return date, 3600 * int(hour) + 60 * int(minute) + Decimal(second)

    def seconds_since(self, epoch: np.datetime64) -> float:
        """Return the seconds from 0 h UTC of the day ``epoch`` to the time of this element."""
        date, seconds = self.time()
        days = int((date - epoch) / np.timedelta64(1, "D"))
        return float(days * 86400 + seconds)

    def _parse(self, word: str) -> float:
        if NUMBER.fullmatch(word):
            value = float(word)
            if abs(value) <= LARGEST:
                return value
            raise self.fault("xml.not_finite", word)
        if _NOT_FINITE.fullmatch(word):
            raise self.fault("xml.not_finite", word)
        raise self.fault("xml.decimal_comma" if DECIMAL_COMMA.fullmatch(word) else "xml.not_a_number", word)

    def _factor(self, quantity: Quantity) -> float:
        unit = self.element.get("unit")
        name = quantity.default if unit is None else str(unit).strip().lower()
        if name not in quantity.factors:
            raise self.fault("xml.unit", unit or "empty", quantity=quantity.name, known=", ".join(quantity.factors))
        return quantity.factors[name]


def element(name: str, content: Any) -> etree._Element:
    """Make an XML element.

    Parameters
    ----------
    name : str
        Name of the element; attributes may follow, for example ``version=1.1``.
    content : mapping, list of pairs, or value
        Children by name, in their order. A list of contents repeats the child. Other values
        become text; floats have all digits that identify them.
    """
    tag, *attributes = name.replace('"', "").split()
    made = etree.Element(tag, dict(word.split("=") for word in attributes))
    if not isinstance(content, Mapping | list):
        made.text = repr(float(content)) if isinstance(content, float) else str(content)
        return made
    for child, value in content.items() if isinstance(content, Mapping) else content:
        is_pairs = isinstance(value, list) and value and isinstance(value[0], tuple)
        made.extend(element(child, one) for one in (value if isinstance(value, list) and not is_pairs else [value]))
    return made


def read_xml(path: str | os.PathLike[str]) -> XmlNode:
    """Parse a file with the safe parser and return its root element; messages show the path as given.

    Raises
    ------
    InputError
        The file is missing, unreadable, too large, not XML or malformed, or it contains a DOCTYPE.
    """
    file = os.fspath(path)
    data = load_bytes(path, "xml_bytes", "xml.unreadable")
    _refuse_other_content(data, file)
    within_memory(sum(data.count(mark) * size for mark, size in _OBJECTS.items()), len(data), file=file)
    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, load_dtd=False,
        dtd_validation=False, huge_tree=False, recover=False,
    )  # fmt: skip
    try:
        root = etree.fromstring(data, parser)
    except etree.XMLSyntaxError as error:
        place = f"line {error.lineno}" if error.lineno else ""
        raise InputError.of("xml.malformed", file=file, place=place, value=error.msg) from None
    if root.getroottree().docinfo.internalDTD is not None:
        raise InputError.of("xml.doctype", file=file, place="prolog", value="<!DOCTYPE")
    return XmlNode(root, file)


def _refuse_other_content(data: bytes, file: str) -> None:
    if not data.strip():
        raise InputError.of("xml.empty_file", file=file, value=f"{len(data)} bytes")
    for magic, name in _MAGIC.items():
        if data.startswith(magic):
            raise InputError.of("xml.not_xml", file=file, value=name)
    if _HTML.match(data):
        raise InputError.of("xml.html", file=file, place="line 1", value=data[:60].decode("ascii", "replace"))
    if _DOCTYPE.match(data):
        raise InputError.of("xml.doctype", file=file, place="prolog", value="<!DOCTYPE")
