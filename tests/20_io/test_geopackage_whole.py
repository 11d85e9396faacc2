"""GeoPackages are read back: GDAL reports no failure of these writes."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pyogrio")

from fg_orient.formats.exchange.gis import write_point_layer
from fg_orient.formats.gdal import require_layers

pytestmark = pytest.mark.behaviour

LAYER = "ground_points"


@pytest.mark.parametrize(
    "lost",
    [
        "DELETE FROM gpkg_spatial_ref_sys WHERE srs_id = 32636",
        "UPDATE gpkg_contents SET max_x = NULL",
        "UPDATE gpkg_ogr_contents SET feature_count = NULL",
        "DELETE FROM gpkg_ogr_contents",
        "DELETE FROM gpkg_extensions",
        "DROP TABLE gpkg_extensions",
        "DROP TRIGGER rtree_ground_points_geom_insert",
        "DROP TRIGGER trigger_delete_feature_count_ground_points",
        "DELETE FROM rtree_ground_points_geom_rowid WHERE rowid = 2",
    ],
)
def test_what_gdal_has_not_written_is_found(tmp_path: Path, lost: str) -> None:
    file, place = tmp_path / "a b?.gpkg", np.array([[5e5, 4.6e6, 10.0], [5.1e5, 4.6e6, np.nan], [np.nan] * 3])
    write_point_layer(file, LAYER, place, {"id": np.array(["a", "b", "c"], object)}, "EPSG:32636", "text")
    require_layers(file, {LAYER: (3, 2)})
    for wrong in ((2, 2), (3, 3)):
        with pytest.raises(OSError, match="has not written all of layer ground_points"):
            require_layers(file, {LAYER: wrong})
    with pytest.raises(OSError, match="other"):
        require_layers(file, {"other": (0, 0)})
    with closing(sqlite3.connect(file)) as database:
        database.execute(lost)
        database.commit()
    with pytest.raises(OSError, match="has not written all"):
        require_layers(file, {LAYER: (3, 2)})
