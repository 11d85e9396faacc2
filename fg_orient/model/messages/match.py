"""Messages about tie points measured in the pixels of images."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
match.no_opencv: matching needs OpenCV
    -> install the extra: pip install 'fg-orient[match]'
match.no_rasterio: reading pixels needs rasterio
    -> install the extra: pip install 'fg-orient[match]'
match.one_image: tie points need at least two images
    -> add [[images]] tables
match.local: the image has no position on the Earth, so its epipolar lines cannot be computed
    -> use tie points of another photogrammetry program (docs/formats)
match.no_pixels: the raster of the image is not found: {value} does not exist, or it contains no pixels and its folder
    has no raster with the same name
    -> name the raster in the project file: pixels = "image.tif" in the [[images]] table
match.pixels: the raster cannot be read: {reason}
    -> give a raster of numbers that GDAL reads
match.no_overlap: no two images overlap at heights from {low:g} to {high:g} m
    -> give <lowest_m> and <highest_m>, or check the metadata
match.none: no pair of images matches: {reason}
    -> give <lowest_m> and <highest_m>, a DEM, or realistic prior sigmas of the orientation
match.table_form: tie points can be added only to CSV tables of this program
    -> convert the table first: fg-orient convert
match.matched: the table already contains matched points of an earlier run
    -> give <overwrite> to replace them
match.table_unreadable: the table cannot be read
    -> save it as CSV in UTF-8
match.no_chip: the point needs {missing}
    -> give coordinates, sigmas and a chip: ID.tif beside the file, or in the folder that has the file's name
match.chip_crs: the chip has no coordinate system
    -> give a georeferenced raster, such as a part of an orthoimage
match.control_crs: control points in {crs} cannot be written to this table
    -> convert them to the CRS of the table: fg-orient convert
match.chip_lost (warning): the chip is not found clearly in any image
match.chip_apart (warning): the position of the chip differs by {distance:.1f} px from the shift of the other chips of
    the image; the chip is left out
match.interrupted (note): interrupted: {done} of {total} {name} are matched and kept
    -> go on with <resume>
match.pair_failed (warning): no tie points: {reason}
match.image_without (warning): the image has no tie points
match.many_rejected (warning): {share:.1f} % of the matches have y-parallaxes beyond 4 standard deviations from a
    smooth trend
    -> the orientation may change fast along the lines (jitter); check the residuals of the adjustment
match.many_wrong (warning): {share:.2f} % of the accepted matches are wrong, as predicted from those beyond the limit
    -> adjust with <snoop> or a robust loss
""")
