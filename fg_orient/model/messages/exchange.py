"""Messages about points, cameras and bundles of other programs."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
interchange.format: unknown format
    -> {hint}
interchange.which: the end of the name does not identify the format
    -> give the format: one of {known}
interchange.files: these are not the files of format {format}
    -> give: {names}
interchange.no_reader: this format can only be written
    -> convert to this format, not from it
interchange.no_writer: this format can only be read
    -> convert from this format, not to it
interchange.needs_model: the format needs cameras and poses, which {source} does not contain
    -> convert from a format that contains them: {known}
interchange.unverified: this reader was never tested with a file from the program itself: pixel origin and columns come
    from descriptions
    -> read docs/formats, compare one point with the program, and add <accept_unverified>
interchange.empty: the file contains no points
    -> give a file with at least one record
interchange.name_missing: the image point lacks the name of its image or point
    -> fill both cells
interchange.name: this name cannot be written to this format: it is empty, has blanks, commas or quotes, or begins with
    #
    -> rename it, or choose another format
interchange.cell_count: the line has the wrong number of cells for this format: {expected}
    -> check separators, and write decimal points, not commas
interchange.cells: the line does not contain the cells of this format
    -> needed: {needed}
interchange.twice: the {kind} occurs twice
    -> remove the wrong one
interchange.sigma: the standard deviation is below zero
    -> give it in {unit}, or 0 if it is unknown
interchange.no_crs: the file does not state its CRS
    -> give the CRS: <crs> EPSG:n, or EPSG:n+m with a vertical CRS
interchange.crs_unknown: the CRS of the file has no EPSG code
    -> give its EPSG code with <crs>
interchange.crs_differs: the CRS of the file is not the one given ({given})
    -> leave <crs> out, or give the CRS of the file with a vertical CRS; the command convert transforms
interchange.geographic: the format contains latitude and longitude, so the CRS must be geographic
    -> give for instance EPSG:4979 (WGS84)
interchange.which_image: the format contains the points of one image, but there are {count} images
    -> give the image: <image> NAME
interchange.columns: the header lacks the column {column}
    -> name the columns as docs/formats shows, or give the right format
interchange.rows_positive: rows are counted downwards, as negative numbers, in this format
    -> export the points again from QGIS: sourceY of a pixel is minus its row
interchange.two_places: the same name has different coordinates on line {first}
    -> give every point its own name
interchange.json: the file is not JSON
interchange.gpkg: the file cannot be read as a GeoPackage
    -> export it again
interchange.geojson: this is not a GeoJSON FeatureCollection of points: {what}
    -> export a layer of points
interchange.layer: the file has no layer {layer} of points
    -> name the layer {layer}, or export it again
interchange.no_pyogrio: GeoPackage needs pyogrio and shapely
    -> install the extra: pip install 'fg-orient[geo]'
interchange.xml_name: this name has control characters, which XML cannot contain
    -> rename it
interchange.unknown_camera: no camera or marker has this id
    -> export the markers again
interchange.swapped_range: longitude and latitude look swapped: this is not a latitude
    -> check which one the format puts first (docs/formats)
interchange.swapped: easting and northing look swapped: after an exchange the points lie in the area of {crs}
    -> exchange the two columns
interchange.no_such_point: no point with coordinates has this id
    -> give ids that are in the file
interchange.needs_height: {what} needs a height
    -> give <height> H for points without one (m)
interchange.needs_sigma_ground: {what} needs standard deviations of ground points
    -> give <sigma_ground> EAST NORTH UP (m)
interchange.needs_sigma_image: {what} needs standard deviations of image points
    -> give <sigma_image> LINE SAMPLE (pixels)
interchange.image_size: this is not an image size
    -> write NAME=LINES,SAMPLES, for instance left=12000,6000
interchange.no_image: the file has no image of this name
    -> choose one of {known}
lost.ground: {format} contains image points only: coordinates are lost
lost.image: {format} contains no image points: image points are lost
lost.ids: {format} has no point ids: the points are numbered in their order
lost.ties: {format} contains no points without coordinates: tie points are lost
lost.heights: {format} has no heights: heights are lost
lost.single: {format} stores single precision: pixel coordinates are rounded
    -> keep a file with the exact values
lost.images: {format} contains one image: image points of the other images are lost
    -> write one file for each image
lost.unmeasured: {format} contains no ground points without image points: such ground points are lost
    -> keep a file that contains them
lost.bare_ties: {format} contains no tie points without image points: such tie points are lost
    -> measure them, if they should take part
lost.vertical_crs: {format} does not state the vertical CRS: the vertical CRS is lost
    -> give the vertical CRS to the program that reads the file, or transform with <to_crs>
lost.sigma_axes: standard deviations are transformed to geocentric axes: their correlations are lost
    -> write <sigma_axes> enu, and give bundle_adjust the option for sigmas of longitude, latitude, height
lost.roles: {format} has no roles: check points become control points
    -> keep a list of the check points, or convert them separately
lost.sigma_ground: {format} has no standard deviations of ground points: these are lost
lost.sigma_east_north: {format} has one horizontal standard deviation: the root mean square of East and North is
    written
lost.sigma_up: {format} has one standard deviation for all axes: the root mean square is written
lost.sigma_image: {format} has no standard deviations of image points: these are lost
    -> set the standard deviations in the program that reads the file
lost.fixed: {format} has no points without uncertainty: fixed points get a standard deviation
    -> choose a small suitable value
lost.crs: {format} does not state the CRS: the CRS is lost
    -> give the CRS to the program that reads the file
remark.unverified (note): the reader of this format was never tested with a file from its program
    -> compare one point with the program
remark.outside_area (note): {count} of {total} points lie outside the area for which {crs} was made
    -> check the CRS and the order of the columns
lost.model: {format} cannot contain the whole model
    -> keep a file that contains the whole model
ties.unreadable: the file cannot be read
    -> check the path and its permissions
ties.missing: the file does not exist
    -> check the path; {needed}
ties.not_text: the file is not UTF-8 text
    -> copy it again, or save it as UTF-8
ties.size: the size of this image is needed
    -> give the size: <image_size> {place}=LINES,SAMPLES
match.layout: the file is not a file of matches, is damaged, or has another layout
    -> copy the file again; if its own program reads it, the layout has changed
match.name: the name does not contain the names of the two images
    -> name the file PREFIX-LEFT__RIGHT.match
match.pair: one file contains the matches of two images only
    -> give a folder: all pairs are written into it
match.image: this image name cannot be part of the name of a file of matches
    -> rename the image; its name must not contain / or __
micmac.name: the file name does not contain the image name, or two files name the same image
    -> name each table PMUL-IMAGE.csv
bundle.lines: the counts of the second line require {expected} lines in total
    -> the file is truncated or damaged: copy it again
bundle.list: the list has fewer images than the bundle, which has at least {last}
    -> give the list of this bundle
bundle.camera: the camera has coefficients that the files of Bundler and BAL do not have
    -> use a camera that has only k1 and k2, or write a text model of COLMAP
photomodeler.size: the export contains no image size, and its marks do not determine the size
    -> give the size: <image_size> {photo}=LINES,SAMPLES
photomodeler.size_found (note): the export contains no image size. Its marks fit best with {fit_lines:.2f} lines and
    {fit_samples:.2f} samples, so {n_lines} lines and {n_samples} samples are used; <image_size> {photo}=LINES,SAMPLES
    sets another size
photomodeler.mark: the export has a mark of a photo or point that it does not contain
photomodeler.part: this part of the export is missing
    -> export the whole project
sba.calibration: cameras with 7 numbers need the file of their camera matrix; cameras with 12 or 17 numbers contain the
    camera matrix
    -> give the cameras, the points and, for 7 numbers, the camera matrix
sba.camera: these numbers are not possible for a frame camera
    -> needed: fx and aspect above 0, skew 0, and aspect 1 if the camera has distortion
libmv.head: the file does not begin with the letters vP (little-endian numbers, pixels)
    -> give a problem_NN.bin that Ceres Solver publishes; other layouts are not known
libmv.length: the counts in the file do not agree with the length of the file
    -> the file is truncated, damaged or has another layout: copy it again
libmv.camera: the focal length is not above 0, or a number is not finite
libmv.rotation: the matrix is not a rotation
libmv.mark: the file has no image or point of this number
libmv.number: a number is not finite
    -> the file is damaged: copy it again
libmv.distortion: the camera has distortion, and the order and direction of its coefficients are not known
    -> undistort the image points, and give zeros
dbat.order: no comment states the order of the cells
    -> begin the file with a line such as: # image id, point id, x, y, sxy
colmap.database: the file is not a database of COLMAP, or is damaged
    -> give database.db
colmap.blob: the length of the record does not agree with its size
    -> the database is damaged: copy it again, or create it again
colmap.model: this camera model is not supported
    -> needed: one of {known}
colmap.camera: the camera has a parameter that Brown's polynomial does not have
    -> needed: k4 = k5 = k6 = 0; undistort the images or calibrate with another model
colmap.reference: the {kind} is not in {other}
colmap.track: the tracks contain {n_tracks} image points, but images.txt refers to {n_images}
    -> use the files of the same model
""")
