"""Read values of a JSON file by their path.

A missing or impossible value gives an error of one line.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from fg_orient.formats.load import load_bytes, parse_json
from fg_orient.model.errors import InputError

_ABSENT: Final = object()


class JsonFile:
    """Object of a JSON file.

    Parameters
    ----------
    path : Path
        The file; used in messages.
    values : dict
    """

    def __init__(self, path: Path, values: dict[str, Any]) -> None:
        self.path, self.values = path, values

    @classmethod
    def read(cls, path: Path, *, skip: int = 0) -> JsonFile:
        """Read a JSON file after its first ``skip`` lines.

        Raises
        ------
        InputError
            The file cannot be read, or it does not contain one JSON object.
        """
        body = load_bytes(path, "json_bytes").split(b"\n", skip)[-1]
        values = parse_json(body, str(path), "json.syntax", f"below line {skip}" if skip else "")
        if not isinstance(values, dict):
            raise InputError.of("json.object", file=path, value=type(values).__name__)
        return cls(path, values)

    def value(self, place: str, default: Any = _ABSENT) -> Any:
        """Return the value at a path such as ``instrument_position.positions``.

        Null counts as missing.
        """
        at: Any = self.values
        for key in place.split("."):
            at = at.get(key) if isinstance(at, dict) else None
        if at is None:
            if default is _ABSENT:
                raise InputError.of("json.missing", file=self.path, place=place)
            return default
        return at

    def numbers(self, place: str, *shape: int, default: Any = _ABSENT) -> Array:
        """Return an array of finite numbers with a given shape; -1 allows any length above 0."""
        given = self.value(place, default)
        try:
            out = np.array(given, float)
        except (TypeError, ValueError, OverflowError):
            out = np.full(1, np.nan)
        pairs = zip(out.shape, shape, strict=False)
        fits = out.ndim == len(shape) and all(n == m or (m == -1 and n > 0) for n, m in pairs)
        if not fits or not np.isfinite(out).all() or isinstance(given, bool):
            expected = " x ".join("any number" if n == -1 else str(n) for n in shape) or "one number"
            raise InputError.of("json.numbers", file=self.path, place=place, value=repr(given)[:60], expected=expected)
        return out

    def number(self, place: str, default: Any = _ABSENT) -> float:
        """Return one finite number."""
        return float(self.numbers(place, default=default))

    def count(self, place: str) -> int:
        """Return a number of lines or samples, which must be a whole number from 1 to a million."""
        value = self.number(place)
        if value != int(value) or not 1 <= value <= 1_000_000:
            raise InputError.of("json.count", file=self.path, place=place, value=value)
        return int(value)

    def text(self, place: str, default: Any = _ABSENT) -> str:
        """Return a text; raise InputError if the value is not a text."""
        value = self.value(place, default)
        if not isinstance(value, str):
            raise InputError.of("json.text", file=self.path, place=place, value=repr(value)[:60])
        return value
