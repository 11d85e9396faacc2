"""Constraints between ground points or images, as the user states them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.model import arrays
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.names import LARGEST, SMALLEST

#: Kinds of constraints with their smallest number of members; the kinds between photos are last.
LEAST: Final = {
    "distance": 2, "parallel": 4, "perpendicular": 4, "equal": 4,
    "plane": 3, "line": 2, "plumb line": 1, "circle": 3, "horizontal circle": 3,
    "sphere": 4, "spheroid": 5, "base": 2, "equal attitude": 2,
}  # fmt: skip
KINDS: Final = tuple(LEAST)
OF_PHOTOS: Final = ("base", "equal attitude")
#: Kinds that need a value in metres, and kinds with a fixed number of members.
MEASURED: Final = ("distance", "base")
EXACT: Final = ("distance", "parallel", "perpendicular", "equal", *OF_PHOTOS)
#: Parameters of figures that can be observed.
OBSERVABLE: Final = {
    "circle": ("radius",), "horizontal circle": ("radius",), "sphere": ("radius",), "spheroid": ("a", "b"),
}  # fmt: skip
AXES: Final = ("x", "y", "z")
#: Number of residuals of each point, and number of unknowns, for each figure.
SIZES: Final = {
    "plane": (1, 3), "line": (2, 4), "plumb line": (2, 2), "circle": (2, 6), "horizontal circle": (2, 4),
    "sphere": (1, 4), "spheroid": (1, 5),
}  # fmt: skip


@dataclass(frozen=True)
class Constraint:
    """Geometric relation between points or photos, such as a distance or a common plane.

    Parameters
    ----------
    kind : str
        One of ``KINDS``. For points: "distance", "parallel", "perpendicular" and "equal" (two points on each of two
        lines), "plane", "line", "plumb line", "circle", "horizontal circle", "sphere", "spheroid". For photos: "base"
        and "equal attitude".
    members : tuple of str
        Names of points or photos.
    value_m : float, optional
        Distance or base.
    sigma : float, optional
        Standard deviation in m; in rad for "parallel", "perpendicular" and "equal attitude". None: a hard
        constraint, which the solution satisfies exactly.
    observed : mapping
        Value and sigma, m, of each observed parameter of the figure: ``radius`` of circles and spheres, ``a`` (across
        the axis) and ``b`` of a spheroid.
    axis : str
        Axis of a spheroid: "x", "y" or "z".
    offset : (3, 3) array
        Rotation from the axes of the first camera to the axes of the second for "equal attitude"; default: identity.

    Raises
    ------
    InputError
        The kind, the number of members or a value is impossible.
    """

    kind: str
    members: tuple[str, ...]
    value_m: float | None = None
    sigma: float | None = None
    observed: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    axis: str = "y"
    offset: Array = field(default_factory=lambda: np.eye(3))

    def __post_init__(self) -> None:
        object.__setattr__(self, "members", arrays.sequence(self.members, "members"))
        for name in self.members:
            if fault := arrays.name_fault(name):
                raise arrays.wrong("members", repr(name), fault)
        if self.kind not in LEAST:
            raise self.fault("kind", self.kind, f"one of {', '.join(KINDS)}")
        for place in ("value_m", "sigma"):
            if getattr(self, place) is not None:
                arrays.array(getattr(self, place), f"{self.label}, {place}", ())
        for name, pair in self.observed.items():
            arrays.array(pair, f"{self.label}, observed {name}", (2,))
        n, least = len(self.members), LEAST[self.kind]
        if n < least or (self.kind in EXACT and n != least) or len(set(self.members)) != n:
            raise self.fault("members", n, f"{least}{'' if self.kind in EXACT else ' or more'} different ones")
        if (self.value_m is None) == (self.kind in MEASURED) or not (self.value_m is None or 0.0 < self.value_m < 1e9):
            raise self.fault("value_m", self.value_m, "a length above 0 for a distance or base, none for others")
        if self.sigma is not None and not SMALLEST <= self.sigma <= LARGEST:
            raise self.fault("sigma", self.sigma, "a number above 0, or none: the constraint is then hard")
        known = OBSERVABLE.get(self.kind, ())
        for name, (value, sigma) in self.observed.items():
            if name not in known or not (0.0 < value <= LARGEST and SMALLEST <= sigma <= LARGEST):
                expected = f"value and sigma of {', '.join(known) or '-'}, above 0"
                raise self.fault(f"observed {name}", f"{value} +- {sigma}", expected)
        if self.axis not in AXES:
            raise self.fault("axis", self.axis, "x, y or z")
        turn = arrays.array(self.offset, f"{self.label}, offset", (3, 3))
        if not np.abs(turn @ turn.T - np.eye(3)).max() <= 1e-9 or np.linalg.det(turn) < 0.0:
            raise self.fault("offset", turn.tolist(), "a rotation matrix")

    @property
    def label(self) -> str:
        """Name of the constraint in messages."""
        return f"{self.kind} of {', '.join(self.members)}"

    @property
    def surplus(self) -> int:
        """Number of residuals of a figure minus its unknowns.

        With 0 the figure fits any such points exactly and tests nothing.
        """
        rows, free = SIZES[self.kind]
        return len(self.members) * rows + len(self.observed) - free

    def require_surplus(self, least: int = 1) -> None:
        """Refuse a figure that has too few points."""
        if self.kind in SIZES and self.surplus < least:
            expected = "more points: a figure of this kind goes through any such points"
            raise self.fault("members", len(self.members), expected)

    def fault(self, place: str, value: object, expected: str) -> InputError:
        """Return the error for an impossible constraint."""
        more = ", ..." if len(self.members) > 6 else ""
        text = f"{self.kind if self.kind in LEAST else 'constraint'} of {', '.join(self.members[:6])}{more}"
        return InputError.of("closerange.constraint", place=f"{text}, {place}", value=value, expected=expected)


def place_of(number: int) -> str:
    """Return the text that names a constraint of a file; numbers begin at 0."""
    return f"constraints[{number + 1}]"


def foreign_members(
    constraints: Sequence[Constraint], points: Collection[str], images: Collection[str], file: str = ""
) -> list[Finding]:
    """Return an error for each member that is not a point or image; ``file`` adds file name and entry number."""
    out = []
    for k, c in enumerate(constraints):
        known = images if c.kind in OF_PHOTOS else points
        place = f"{place_of(k)}.members" if file else c.label
        out += [
            finding("closerange.member", file=file, place=place, value=name, known=", ".join([*known][:10]))
            for name in c.members
            if name not in known
        ]
    return out
