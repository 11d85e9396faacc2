"""An HTML page is read without a browser."""

from __future__ import annotations

import dataclasses
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np

from fg_orient.result.plain import Table
from fg_orient.result.record import Result

VOID = {"meta", "br", "img", "link", "input", "hr"}


class Structure(HTMLParser):
    """The parser collects tags, ids, attributes and text, and fails on tags that do not match."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[str] = []
        self.ids: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]
        self.ids += [value or "" for name, value in attrs if name == "id"]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open[-1] == tag, f"</{tag}> closes {self.open[-3:]}"
        self.open.pop()

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def structure(page: Path | str) -> Structure:
    """Parse a page, from its file or its text."""
    found = Structure()
    found.feed(page if isinstance(page, str) else page.read_text("utf-8"))
    found.close()
    assert found.open == []
    return found


def with_columns(result: Result, table: str, columns: dict[str, Any]) -> Result:
    """Return the result with other columns of one table."""
    return dataclasses.replace(result, tables={**result.tables, table: Table(columns)})


def of_large_images(result: Result) -> Result:
    """Return the same points in images twelve times as large."""
    images = []
    for image in result.record["images"]:
        corners = np.array(image["footprint_lon_lat_deg"], float)
        grown = corners.mean(axis=0) + 12.0 * (corners - corners.mean(axis=0))
        images.append({**image, "footprint_lon_lat_deg": grown.tolist()})
    return dataclasses.replace(result, record={**result.record, "images": images})
