"""Mutations change bytes, lines, cells, numbers and members of archives; a seed repeats a sequence."""

from __future__ import annotations

import gzip
import io
import random
import re
import zipfile
from collections.abc import Callable, Sequence
from typing import Final

#: Numbers that readers treat specially, or should.
NUMBERS: Final = (
    "0", "-0", "-1", "1", "nan", "inf", "-inf", "1e400", "-1e308", "1e-320", "1e30", "0x10", "1_0", "1,5", "٣",
    "2147483648", "-2147483649", "4294967296", "9223372036854775808", "18446744073709551616", "1" * 400, "9" * 5000,
    "0.1.2", "+", "1e",
)  # fmt: skip
#: Words that formats treat specially.
WORDS: Final = (
    "", " ", "\t", "\x00", "\r", "\n", "\n\n", "#", "'", '"', '""', ",", ";", "|", "..", "../../etc/passwd", "/",
    "\\", "=1+1", "@", "null", "true", "false", "None", "[]", "{}", "[", "]", "{", "}", "<", ">", "&", "<!DOCTYPE a>",
    "<!--", "]]>", "\ufeff", "\u202e", "İ", "ß", "𝟙", "a" * 3000, "EPSG:4326", "EPSG:0", "EPSG:99999",
    "EPSG:32636+5773", "control", "check", "tie", "fixed", "%s", "{0}", "\x1b[2J", "-----", "1 2 3", "inf,nan",
)  # fmt: skip
_NUMBER: Final = re.compile(rb"[-+]?[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?")
_WORD: Final = re.compile(rb"[A-Za-z_][\w.-]*")
_CELL: Final = re.compile(rb"[^\s,;<>=\"'{}\[\]:]+")
#: Longest file that a mutation makes, bytes.
LONGEST: Final = 2_000_000


def mutated(data: bytes, rng: random.Random, others: Sequence[bytes] = ()) -> bytes:
    """Change a file in one to six places, inside its members if it is an archive.

    Parameters
    ----------
    data : bytes
    rng : random.Random
    others : sequence of bytes
        Other files of the reader, parts of which are inserted.
    """
    inside = {b"PK\x03\x04": _inside, b"\x1f\x8b\x08\x00": _unpacked}.get(data[:4])
    if inside is not None and rng.random() < 0.6:
        inner = inside(data, rng, others)
        if inner is not None:
            return inner
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        change = rng.choice(_TEXT if b"\0" not in data[:2000] else _BINARY)
        data = change(data, rng, others)[:LONGEST]
    return data


def _inside(data: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes | None:
    """Return the archive with one member changed, left out, doubled or renamed; None if it is not readable."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = [(info.filename, archive.read(info), info.compress_type) for info in archive.infolist()]
    except Exception:
        return None
    k = rng.randrange(len(members)) if members else 0
    out = io.BytesIO()
    kind = rng.random()
    with zipfile.ZipFile(out, "w") as archive:
        for j, (name, content, how) in enumerate(members):
            if j == k and kind < 0.05:
                continue
            if j == k and kind < 0.1:
                name = name.rpartition(".")[0] + rng.choice(("", "x", "..", "/../a"))
            if j == k and kind >= 0.1:
                content = mutated(content, rng, others)
            archive.writestr(zipfile.ZipInfo(name[:60000]), content, how)
    return out.getvalue()


def _unpacked(data: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes | None:
    """Return the gzip file with changed content; None if it is not readable."""
    try:
        content = gzip.decompress(data)
    except Exception:
        return None
    return gzip.compress(mutated(content, rng, others), 1, mtime=0)


def _at(data: bytes, rng: random.Random) -> int:
    """Return the position in a file, near its beginning in half of the cases."""
    end = len(data) if rng.random() < 0.5 else min(len(data), 300)
    return rng.randrange(end + 1)


def _flip(data: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    if not data:
        return b"\0"
    k = min(_at(data, rng), len(data) - 1)
    return data[:k] + bytes([data[k] ^ (1 << rng.randrange(8))]) + data[k + 1 :]


def _byte(data: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    k = _at(data, rng)
    return (
        data[:k]
        + bytes([rng.choice((0, 1, 9, 10, 13, 32, 127, 128, 255, rng.randrange(256)))])
        + data[k + rng.randrange(2) :]
    )


def _cut(data: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    k = _at(data, rng)
    return data[:k] if rng.random() < 0.4 else data[:k] + data[k + 1 + rng.randrange(1 + min(len(data), 200)) :]


def _repeat(data: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    k = _at(data, rng)
    part = data[k : k + 1 + rng.randrange(60)]
    return data[:k] + part * rng.choice((2, 2, 3, 50, 2000)) + data[k:]


def _insert(data: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    k = _at(data, rng)
    return data[:k] + rng.choice((*WORDS, *NUMBERS)).encode("utf-8", "surrogatepass") + data[k:]


def _splice(data: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    other = rng.choice(others) if others else data
    k, j = _at(data, rng), _at(other, rng)
    return data[:k] + other[j : j + rng.randrange(1 + min(len(other), 2000))] + data[k + rng.choice((0, 0, 5, 100)) :]


def _replaced(
    pattern: re.Pattern[bytes], words: Sequence[str]
) -> Callable[[bytes, random.Random, Sequence[bytes]], bytes]:
    """Return the mutation that replaces one match of a pattern by a word, or by another match of the file."""

    def change(data: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
        start = _at(data, rng)
        found = pattern.search(data, start) or pattern.search(data)
        if found is None:
            return _insert(data, rng, others)
        if rng.random() < 0.25:
            other = pattern.search(data, _at(data, rng))
            word = other[0] if other else b""
        else:
            word = rng.choice(words).encode("utf-8", "surrogatepass")
        return data[: found.start()] + word + data[found.end() :]

    return change


def _lines(data: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    lines = data.split(b"\n")
    j, k = rng.randrange(len(lines)), rng.randrange(len(lines))
    what = rng.randrange(5)
    if what == 0:
        lines[j], lines[k] = lines[k], lines[j]
    elif what == 1:
        del lines[j]
    elif what == 2:
        lines.insert(k, lines[j])
    elif what == 3:
        lines[j : j + 1] = [lines[j]] * rng.choice((2, 20, 500))
    else:
        cells = re.split(rb"([,; \t]+)", lines[j])
        if len(cells) > 2:
            m = 2 * rng.randrange((len(cells) + 1) // 2)
            cells[m : m + rng.randrange(3)] = [rng.choice((b"", *cells))]
        lines[j] = b"".join(cells)
    return b"\n".join(lines)


def _encoding(data: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    what = rng.randrange(6)
    if what == 0:
        return b"\xef\xbb\xbf" + data
    if what == 1:
        return data.replace(b"\n", b"\r\n")
    if what == 2:
        return data.replace(b"\n", b"\r")
    if what == 3:
        return data.decode("latin-1").encode("utf-16")
    if what == 4:
        return data.replace(b".", b",")
    return data.replace(b",", b";")


def _nested(data: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    k, n = _at(data, rng), rng.choice((5, 200, 3000, 60000))
    return data[:k] + rng.choice((b"[", b"{", b"(", b'{"a":', b"<a>", b"a.", b"[[", b"{a=", b"-", b"'")) * n + data[k:]


def _words(data: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    number = rng.choice((0, 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63, 2**64 - 1, rng.randrange(2**16)))
    size = rng.choice((1, 2, 4, 8))
    k = _at(data, rng)
    return data[:k] + (number % 256**size).to_bytes(size, rng.choice(("little", "big"))) + data[k + size :]


_BINARY: Final = (
    _flip,
    _flip,
    _byte,
    _cut,
    _repeat,
    _insert,
    _splice,
    _words,
    _words,
    _words,
    _replaced(_NUMBER, NUMBERS),
)
_TEXT: Final = (
    _flip, _byte, _cut, _repeat, _insert, _splice, _lines, _lines, _lines, _encoding, _nested,
    *(_replaced(_NUMBER, NUMBERS),) * 4, *(_replaced(_WORD, WORDS),) * 2, *(_replaced(_CELL, (*NUMBERS, *WORDS)),) * 3,
)  # fmt: skip
