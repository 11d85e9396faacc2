"""GeoPackage: a layer ``ground_points`` and a table ``image_points``, the columns of our tables.

Needs pyogrio and shapely (extra ``geo``). Geometries are points with Z, longitude or easting first, in the CRS of the
survey; tie points have no geometry. Pixel (0, 0) is the centre of the first pixel, as in our tables.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.formats.atomic import staged_file
from fg_orient.formats.exchange.survey import UNKNOWN, Gathering, Survey
from fg_orient.formats.gdal import plain_case
from fg_orient.formats.observations import COLUMNS
from fg_orient.formats.points import SIGMA_COLUMNS
from fg_orient.formats.registry import Format, Holds, Settings
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role

GROUND: Final = "ground_points"
IMAGE: Final = "image_points"
#: Version 1.2 is sufficient; QGIS before 3.28 warns of later versions.
GPKG_OPTIONS: Final = {"VERSION": "1.2"}


def _libraries(file: Path) -> tuple[Any, Any]:
    """Pyogrio and shapely, imported on demand."""
    try:
        with plain_case():
            import pyogrio
        import shapely
    except ImportError as error:
        raise InputError.of("interchange.no_pyogrio", file=file) from error
    return pyogrio, shapely


def _layer(pyogrio: Any, path: Path, layer: str) -> tuple[dict[str, Any], Any, dict[str, Any]]:
    """Description, geometries (WKB) and columns of a layer."""
    meta, _, geometry, columns = pyogrio.raw.read(path, layer=layer)
    return meta, geometry, dict(zip(meta["fields"], columns, strict=True))


def read(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read both layers; the second may be missing."""
    path = paths[0]
    pyogrio, shapely = _libraries(path)
    if not path.is_file():
        raise InputError.of("table.missing_file", file=path)
    try:
        with plain_case():
            layers = [str(name) for name, _ in pyogrio.list_layers(path)]
            ground = _layer(pyogrio, path, GROUND) if GROUND in layers else None
            image = _layer(pyogrio, path, IMAGE) if IMAGE in layers else None
    except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError) as error:
        raise InputError.of("interchange.gpkg", file=path, value=str(error).split(";")[0]) from None
    if ground is None or "id" not in ground[2]:
        raise InputError.of("interchange.layer", file=path, value=", ".join(layers), layer=GROUND)
    gathered = Gathering(path, settings.crs, ground[0]["crs"] or "")
    _take_ground(gathered, shapely.from_wkb(ground[1]), ground[2])
    if image is not None:
        _take_image(gathered, image[2], path)
    return gathered.finished()


def _take_ground(gathered: Gathering, geometry: Any, columns: dict[str, Any]) -> None:
    n = len(geometry)
    sigmas = np.stack([np.asarray(columns.get(name, np.full(n, np.nan)), float) for name in SIGMA_COLUMNS], axis=1)
    roles, fixed = columns.get("role", [Role.CONTROL] * n), columns.get("fixed", np.zeros(n, bool))
    for k, point in enumerate(geometry):
        name = "" if columns["id"][k] is None else str(columns["id"][k])
        if point is None or point.is_empty:
            gathered.point(name, Role.TIE, UNKNOWN, line=k + 1)
        elif point.geom_type != "Point":
            gathered.faults.add("interchange.layer", place=f"feature {k + 1}", value=point.geom_type, layer=GROUND)
        else:
            xyz = (point.x, point.y, point.z if point.has_z else np.nan)
            gathered.feature(name, roles[k], xyz, sigmas[k].tolist(), number=k + 1, fixed=bool(fixed[k]))


def _take_image(gathered: Gathering, columns: dict[str, Any], path: Path) -> None:
    for column in COLUMNS:
        if column not in columns:
            raise InputError.of("interchange.columns", file=path, place=f"layer {IMAGE}", column=column)
    for k, (image, name, line, sample, *sigma) in enumerate(zip(*(columns[c] for c in COLUMNS), strict=True), start=1):
        if not np.isfinite([line, sample]).all():
            gathered.faults.add("table.not_a_number", place=f"layer {IMAGE}, feature {k}", value=f"{line} {sample}")
        gathered.measure(str(image or ""), str(name or ""), float(line), float(sample), sigma, line=k)


def write(survey: Survey, paths: tuple[Path, ...], settings: Settings) -> None:
    """Write both layers; the second only if there are image points."""
    pyogrio, shapely = _libraries(paths[0])
    geometry: npt.NDArray[np.object_] = shapely.to_wkb(shapely.points(np.nan_to_num(survey.coordinates)))
    geometry[~survey.located] = None
    flat = survey.located & np.isnan(survey.coordinates[:, 2])
    geometry[flat] = shapely.to_wkb(shapely.points(survey.coordinates[flat, :2]))
    roles = [str(role) for role in survey.roles]
    text = [np.array(survey.ids, object), np.array(roles, object)]
    with staged_file(paths[0], suffix=".gpkg") as temporary, plain_case():
        pyogrio.raw.write(
            temporary, geometry, [*text, *survey.sigma_enu_m.T, survey.fixed], ["id", "role", *SIGMA_COLUMNS, "fixed"],
            layer=GROUND, driver="GPKG", geometry_type="Point Z", crs=survey.crs, dataset_options=GPKG_OPTIONS,
        )  # fmt: skip
        if len(o := survey.observed):
            names = [np.array(survey.images, object)[o.image], np.array(survey.ids, object)[o.point]]
            columns = [*names, o.line, o.sample, o.sigma_line_px, o.sigma_sample_px]
            pyogrio.raw.write(temporary, None, columns, list(COLUMNS), layer=IMAGE, driver="GPKG", append=True)


FORMAT = Format(
    name="gpkg",
    title="GeoPackage",
    suffixes=(".gpkg",),
    first_pixel=(0.0, 0.0),
    pixel_axes="line, sample (pixels)",
    ground_axes="longitude or easting, latitude or northing, height (m)",
    holds=frozenset(Holds),
    read=read,
    write=write,
    evidence="written and read by GDAL (tests)",
)
