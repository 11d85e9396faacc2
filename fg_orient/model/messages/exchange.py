"""Messages about points, cameras and bundles of other programs."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
interchange.format: no such format
    -> {hint}
interchange.which: the end of the name does not tell the format
    -> name it: one of {known}
interchange.files: the format {format} has other files
    -> give: {names}
interchange.no_reader: the format is only written
    -> convert to it, not from it
interchange.no_writer: the format is only read
    -> convert from it, not to it
interchange.needs_model: the format holds cameras and poses, which {source} does not
    -> convert from a format that holds a model, too: {known}
interchange.unverified: this reader was never tried on a file of the program itself: pixel origin and columns are
    from descriptions
    -> look at docs/formats, compare one point with the program, and add <accept_unverified>
interchange.empty: the file holds no points
    -> give a file with at least one record
interchange.name_missing: the image point lacks the name of its image or point
    -> fill both cells
interchange.name: the format cannot hold this name: it is empty, has blanks, commas or quotes, or begins with #
    -> rename it, or choose another format
interchange.cell_count: the line has the wrong number of cells for this format: {expected}
    -> check separators, and write decimal points, not commas
interchange.cells: the line does not contain the cells of this format
    -> needed: {needed}
interchange.twice: the {kind} occurs twice
    -> remove the wrong one
interchange.sigma: the standard deviation is below zero
    -> give it in {unit}, or 0 if it is unknown
interchange.no_crs: the file does not say its CRS
    -> give it: <crs> EPSG:n, or EPSG:n+m with a vertical CRS
interchange.crs_unknown: the CRS of the file is none of EPSG
    -> give its EPSG code with <crs>
interchange.crs_differs: the CRS of the file is not the one given ({given})
    -> leave <crs> out, or give the same with a vertical CRS; the command convert transforms
interchange.geographic: the format holds latitude and longitude: the CRS has to be geographic
    -> give for instance EPSG:4979 (WGS84)
interchange.which_image: the format holds the points of one image, the survey has {count}
    -> say which one: <image> NAME
interchange.columns: the header lacks the column {column}
    -> name the columns as docs/formats shows, or give the right format
interchange.rows_positive: rows are counted downwards, as negative numbers, in this format
    -> export the points again from QGIS: sourceY of a pixel is minus its row
interchange.two_places: the same name has other coordinates on line {first}
    -> give every point its own name
interchange.json: the file is no JSON
interchange.gpkg: the file cannot be read as a GeoPackage
    -> export it again
interchange.geojson: not a GeoJSON FeatureCollection of points: {what}
    -> export a layer of points
interchange.layer: the file has no layer {layer} of points
    -> name the layer {layer}, or export it again
interchange.no_pyogrio: GeoPackage needs pyogrio and shapely
    -> install the extra: pip install 'fg-orient[geo]'
interchange.xml_name: XML cannot hold this name: it has control characters
    -> rename it
interchange.unknown_camera: no camera or marker has this id
    -> export the markers again
interchange.swapped_range: longitude and latitude look swapped: this is no latitude
    -> check which one the format puts first (docs/formats)
interchange.swapped: easting and northing look swapped: exchanged, the points lie where {crs} is used
    -> exchange the two columns
interchange.no_such_point: no point with coordinates has this id
    -> give ids of the file
interchange.needs_height: {what} needs a height
    -> give <height> H for points without one (m)
interchange.needs_sigma_ground: {what} needs standard deviations of ground points
    -> give <sigma_ground> EAST NORTH UP (m)
interchange.needs_sigma_image: {what} needs standard deviations of image points
    -> give <sigma_image> LINE SAMPLE (pixels)
interchange.image_size: this is no size of an image
    -> write NAME=LINES,SAMPLES, for instance left=12000,6000
interchange.no_image: the file has no such image
    -> choose one of {known}
lost.ground: {format} holds image points only: coordinates are lost
lost.image: {format} holds no image points: they are lost
lost.ids: {format} has no ids of points: they are numbered in their order
lost.ties: {format} holds no points without coordinates: tie points are lost
lost.heights: {format} has no heights: they are lost
lost.single: {format} holds single precision: pixels are rounded
    -> keep a file that holds them
lost.images: {format} holds one image: image points of the others are lost
    -> write one file for each image
lost.unmeasured: {format} holds no ground points without image points: they are lost
    -> keep a file with them
lost.bare_ties: {format} holds no tie points that no image shows: they are lost
    -> measure them, if they should count
lost.vertical_crs: {format} does not say what heights refer to: the vertical CRS is lost
    -> tell it to the program that reads the file, or transform with <to_crs>
lost.sigma_axes: standard deviations are turned to geocentric axes: their correlations are lost
    -> write <sigma_axes> enu, and give bundle_adjust the option for sigmas of longitude, latitude, height
lost.roles: {format} has no roles: check points become control
    -> keep a list of them, or convert them apart, so that they stay check points
lost.sigma_ground: {format} has no standard deviations of ground points: they are lost
lost.sigma_east_north: {format} has one horizontal standard deviation: the root mean square of East and North is
    written
lost.sigma_up: {format} has one standard deviation for all axes: the root mean square is written
lost.sigma_image: {format} has no standard deviations of image points: they are lost
    -> set them in the program that reads the file
lost.fixed: {format} has no points without uncertainty: they get their standard deviation
    -> choose small ones that fit
lost.crs: {format} does not say the CRS: it is lost
    -> tell it to the program that reads the file
remark.unverified (note): the reader of this format was never tried on a file of its program
    -> compare one point with the program
remark.outside_area (note): {count} of {total} points lie outside the area for which {crs} was made
    -> check the CRS and the order of the columns
lost.model: {format} cannot hold all of the model
    -> keep a file that holds it
ties.unreadable: the file cannot be read
    -> check the path and its permissions
ties.missing: the file does not exist
    -> check the path; {needed}
ties.not_text: the file is not UTF-8 text
    -> copy it again, or save it as UTF-8
ties.size: the size of this image is needed
    -> give it: <image_size> {place}=LINES,SAMPLES
match.layout: the file is no file of matches, is damaged, or has another layout
    -> copy it again; if the program reads it, its layout has changed
match.name: the name does not tell the two images
    -> name it PREFIX-LEFT__RIGHT.match
match.pair: one file holds the matches of two images
    -> give a folder: all pairs are written into it
match.image: this name cannot stand in the name of a file of matches
    -> rename the image: no / and no __
micmac.name: the name does not tell the image, or tells one twice
    -> name each table PMUL-IMAGE.csv
bundle.lines: the counts of the second line ask for {expected} lines in all
    -> the file is truncated or damaged: copy it again
bundle.list: the list has fewer images than the bundle ({last} at least)
    -> give the list of this bundle
bundle.camera: the camera has coefficients that the files of Bundler and BAL do not have
    -> needed: k1 and k2 alone; write a text model of COLMAP
photomodeler.size: the export holds no image size, and its marks do not determine it
    -> give it: <image_size> {photo}=LINES,SAMPLES
photomodeler.size_found (note): the export holds no image size: {n_lines} lines, {n_samples} samples are the whole
    numbers next to those that fit its marks best ({fit_lines:.2f}, {fit_samples:.2f}); <image_size>
    {photo}=LINES,SAMPLES gives another
photomodeler.mark: a mark of a photo or point that the export does not hold
photomodeler.part: this part of the export is missing
    -> export the whole project
sba.calibration: cameras of 7 numbers need the file of their camera matrix, and cameras of 12 or 17 have their own
    -> give the cameras, the points and, for 7 numbers, the camera matrix
sba.camera: there is no frame camera with these numbers
    -> needed: fx and aspect above 0, skew 0, and aspect 1 where the camera has distortion
libmv.head: the file does not begin with the letters vP, for little-endian numbers and pixels
    -> give a problem_NN.bin that Ceres Solver publishes; other layouts are not known
libmv.length: the counts do not fit the length of the file
    -> the file is truncated, damaged or has another layout: copy it again
libmv.camera: the focal length is not above 0, or a number is not finite
libmv.rotation: the matrix is not a rotation
libmv.mark: the file has no such image or point
libmv.number: a number is not finite
    -> the file is damaged: copy it again
libmv.distortion: the camera has distortion, and the order and direction of its coefficients are not known
    -> undistort the image points, and give zeros
dbat.order: no comment tells the order of the cells
    -> begin the file with a line such as: # image id, point id, x, y, sxy
colmap.database: the file is no database of COLMAP, or damaged
    -> give database.db
colmap.blob: the record does not hold what its size says
    -> the database is damaged: copy or make it again
colmap.model: this camera model has no counterpart here
    -> needed: one of {known}
colmap.camera: the camera has a parameter that Brown's polynomial does not have
    -> needed: k4 = k5 = k6 = 0; undistort the images or calibrate with another model
colmap.reference: the {kind} is not in {other}
colmap.track: the tracks hold {n_tracks} image points, images.txt refers to {n_images}
    -> take the files of one and the same model
""")
