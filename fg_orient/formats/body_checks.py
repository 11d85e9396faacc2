"""Check that images, points and the project belong to the same body."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from fg_orient.geodesy import BODY_FIXED, is_of_body
from fg_orient.model.errors import InputError

if TYPE_CHECKING:
    from fg_orient.model.block import Image
    from fg_orient.sensors.base import Sensor

#: Largest relative difference of the major axis of a body between the images and the CRS of the
#: points. One of them may use a sphere.
SAME_BODY: Final = 0.01


def require_body(given: str | tuple[float, float, float] | None, sensor: Sensor, file: str) -> None:
    """Refuse an image that shows another body than the project states: a name, three radii (m), or None."""
    if given is None:
        return
    from fg_orient.geodesy.bodies import Body, body_named

    try:
        body = body_named(given) if isinstance(given, str) else Body("body", given)
    except InputError as error:
        raise InputError(*(replace(p, file=file) for p in error.problems)) from None
    own = sensor.body
    if own is None or not own.same(body):
        value = "the Earth" if own is None else f"{own.name}, radii {' '.join(f'{r:.10g}' for r in own.radii_m)} m"
        raise InputError.of("body.differs", file=sensor.file, place="radii", value=value)


def require_crs(images: Iterable[Image | None], crs: str, file: str) -> None:
    """Refuse a CRS of the Earth for images of another body, the reverse, and a CRS of a third body."""
    body = next((image.sensor.body for image in images if image is not None and image.sensor.body is not None), None)
    here = "the Earth" if body is None else f"{body.name}, {body.radii_m[0]:.10g} m"
    if crs and (body is None) == (crs == BODY_FIXED or is_of_body(crs)):
        raise InputError.of("body.crs", file=file, place="points.crs", value=f"{crs}, images on {here}")
    if body is not None and is_of_body(crs):
        from fg_orient.geodesy.bodies import body_named

        try:
            on = body_named(crs)
        except InputError as error:
            raise InputError(*(replace(p, file=file, place="points.crs") for p in error.problems)) from None
        if abs(on.radii_m[0] / body.radii_m[0] - 1.0) > SAME_BODY:
            value = f"{crs}, {on.name}, {on.radii_m[0]:.10g} m; images on {here}"
            raise InputError.of("body.crs", file=file, place="points.crs", value=value)
