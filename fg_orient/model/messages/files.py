"""Messages about files: metadata, sensors, terrain models, coordinates, tables, project files; notes of readers."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
xml.missing_file: the file does not exist
    -> check the path; it is taken relative to {base}
xml.not_a_file: this is a folder or a device, not a file
    -> give the metadata file itself
xml.unreadable: the file cannot be read
    -> check its permissions
xml.too_large: the file is larger than the limit of {limit} bytes
    -> read it from Python with a larger max_bytes if you trust it
xml.empty_file: the file is empty
    -> copy or download it again
xml.not_xml: the file is not XML
    -> give the metadata file (METADATA.DIM or DIM_*.XML)
xml.html: the file is an HTML page, probably an error page of a download
    -> download the metadata file again
xml.malformed: the XML is damaged
    -> copy or download the file again
xml.doctype: the file holds a DOCTYPE, which no DIMAP product has and which can hide an attack
    -> remove it if you trust the file
xml.missing_element: element {element} is missing
xml.too_few: the file needs at least {at_least} {element}
dimap.detectors_cover: look angles must cover detectors {first} to {last} (NCOLS)
    -> use the complete metadata file of the product
xml.doubled: the element may occur only once here
    -> remove the wrong one
xml.empty: the element is empty
    -> fill it or use the original file
xml.not_plain: the element must hold a plain value, no markup
xml.not_finite: this is not a finite number of possible size
xml.not_whole: this is not a whole number
xml.wrong_count: the element needs {expected} numbers separated by blanks
dimap.pixel_origin: pixels must be counted from 1 in this format
dimap.quaternion_norm: a quaternion must have norm 1 within {tolerance:g} over the whole image
sensor.no_field: first and last sample look in the same direction (less than {least:g} rad apart)
    -> use the original file
xml.not_a_number: this is not a number
    -> write it as 123.456 or 1.23e4
xml.decimal_comma: the number has a decimal comma
table.decimal_comma: the number has a decimal comma
    -> write a decimal point
xml.out_of_range: the value lies outside the possible range {low:g} .. {high:g}{unit}
    -> check the value and its unit
xml.unit: this is no known unit for a {quantity}
sensor.model: no such kind of model
    -> choose one of {known}
xml.not_a_time: this is not a UTC time
    -> write it as 2005-03-13T05:21:07.332158Z
dimap.other_format: this is no DIMAP product file that can be read
    -> give METADATA.DIM of a SPOT 1-5 level 1A scene, DIM_*.XML of a Pléiades 1A/1B or SPOT 6/7 sensor product, or
       a PHRDIMAP
dimap.other_version: this version of DIMAP is not read
    -> needed: DIMAP 1.1 (SPOT 1-5) or DIMAP 2.x (Pléiades 1A/1B, SPOT 6/7); newer missions: use their RPC
dimap.other_mission: the rigorous model of this mission is not read
    -> needed: SPOT 1-7 or Pléiades 1A/1B; other missions: use their RPC
dimap.other_level: the image is resampled: its viewing model is no longer in the file
    -> needed: level 1A (SPOT 1-5) or the sensor product (profile PHR_SENSOR, S6_SENSOR, S7_SENSOR; PHR_DIMAP of
       level SENSOR)
dimap.rpc_file: the file holds RPC, not the rigorous model
    -> give the DIM_*.XML of the same folder, or use the RPC commands
dimap.time_order: times must increase
dimap.detector_order: detector numbers must increase
    -> sort the list or remove the repeated entry
dimap.radius: the distance from the Earth's centre must be {low:g} .. {high:g} m
    -> check unit and frame (Earth-fixed, m)
dimap.speed: the speed must be {low:g} .. {high:g} m/s
    -> check unit and frame (Earth-fixed, m/s)
dimap.quaternion_span: OFFSET and SCALE do not belong to the time of the image (scaled time beyond +-{limit:g})
    -> check day and unit of OFFSET and SCALE (s of the day)
dimap.duration: {n_lines} lines at this period do not fill START .. END ({duration:.6g} s)
    -> check LINE_PERIOD and its unit attribute, NROWS, START and END
dimap.look_angle: a viewing direction lies more than 45 degrees off
    -> check the look angle polynomial
dimap.speed_span: angular speeds cover {first:.3f} .. {last:.3f} s of the day, too little for the image; at most
    {hold} s are held
    -> use a metadata file whose angular speeds cover the image
dimap.speed_gap: a gap in the angular speeds; a speed is held for at most {hold} s
    -> use a metadata file with the complete list
dimap.anchor: the first absolute attitude lies more than {hold} s outside the angular speeds
    -> use a metadata file whose angular speeds start with the absolute attitude
dimap.not_writable: this metadata cannot be written as {target}
    -> {needed}
sensor.not_rigorous: the published procedure needs the rigorous model of a pushbroom image
    -> give METADATA.DIM or DIM_*.XML; RPC images take part in adjust
sensor.ephemeris_span: the ephemeris covers {first:.6f} .. {last:.6f} s of the day only and is never extrapolated
    -> use a metadata file whose state vectors cover the image
sensor.attitude_span: the attitudes cover {first:.6f} .. {last:.6f} s of the day, {gap:.3f} s less than what is
    asked for
    -> stay within {lines}, or extrapolate with the last rate: <extrapolate_attitude_s> SECONDS
sensor.extrapolation: attitudes are extrapolated for 0 to {most:g} s only
    -> give the seconds that are missing, such as 0.2
sensor.missing: the file does not exist
dem.missing: the DEM file does not exist
    -> check the path
sensor.own_reader: the plugin that reads it, {where}, raised an exception
    -> correct it there; report file errors with InputError; <debug> shows the traceback
sensor.only_rpc: the file holds an RPC, no rigorous model
    -> use its RPC (<model> rpc), or give the DIM_*.XML or METADATA.DIM of the image
sensor.pixel_outside: pixel outside the image
    -> lines run from {first_line:g} to {last_line:g}, samples from {first_sample:g} to {last_sample:g}; whole
       numbers are centres of pixels
sensor.ray_misses: the viewing ray does not meet the Earth at this height
    -> check the height (m, ellipsoidal)
dem.no_rasterio: reading a DEM needs rasterio
    -> install the extra: pip install 'fg-orient[geo]'
dem.no_crs: the DEM has no coordinate reference system
    -> assign one, for instance with gdal_edit -a_srs
dem.vertical_crs: the DEM states another vertical CRS than the one given
    -> leave the option out, or correct the file
dem.geoid: the DEM's heights cannot be brought to the ellipsoid: {reason}
    -> put the grid into PROJ's folder (projsync, PROJ_DATA), or convert the DEM to ellipsoidal heights
dem_control.sigma: the sigma of heights from a DEM is no positive number
    -> give metres, such as 3
dem_control.both: a DEM as control needs its sigma, and a sigma a DEM
    -> give <dem_control> and <dem_sigma>
dem_control.no_point: no point to be observed lies over the DEM
    -> use a DEM that covers the block, and a block with tie points
dem.vertical_unit: the DEM's heights are not in metres
    -> convert them to metres
dem.unreadable: the DEM cannot be read
    -> give a raster that GDAL reads
dem.implausible (warning): {count} cells have heights below {low:g} or above {high:g} m ({least:g} to {most:g}): taken
    as nodata, which the file does not declare
    -> declare it, for instance with gdal_edit -a_nodata
dem.not_covered: a viewing ray meets nodata or comes from outside the DEM below its highest point
    -> use a DEM without holes that covers the image footprint and what lies in front of it
geodesy.not_epsg: the coordinate reference system is not an EPSG code
    -> write EPSG:n, or EPSG:n+m with a vertical CRS, for instance EPSG:4979 or EPSG:32636
geodesy.unknown_crs: no such EPSG code
    -> look it up at epsg.org; WGS84 longitude, latitude, height is EPSG:4979
geodesy.not_spatial: the CRS has no horizontal coordinates and height
    -> give a geographic, projected or geocentric CRS
geodesy.axes: the axes of the CRS are not {unit}s to the east and north and metres up
    -> convert the coordinates first, for instance to EPSG:4979
geodesy.not_vertical: this is not a vertical CRS
    -> give one such as EPSG:5773 (EGM96) or EPSG:3855 (EGM2008)
geodesy.vertical_name: no vertical CRS of EPSG has this name
    -> give its code, or one of these names: {hint}
geodesy.no_operation: PROJ has no exact operation to WGS84; it needs {grids}
    -> install the grid (projsync, or a folder that PROJ_DATA names), give <geoid> a file, or give ellipsoidal heights
       and no vertical CRS
geoid.no_rasterio: reading a geoid file needs rasterio
    -> install the extra: pip install 'fg-orient[geo]'
geoid.missing: the geoid file does not exist
    -> check the path
geoid.unreadable: the geoid file cannot be read
    -> give a raster of undulations that GDAL reads: GTX, GeoTIFF, ISG, BYN
geoid.unit: the undulations of the geoid file are not in metres
    -> convert them to metres
geoid.outside: the geoid file does not cover a point
    -> give one that covers the block
geoid.no_value: the geoid file has no value at a point
    -> give one that covers the block
geoid.too_large: the points lie so far apart that too many cells of the geoid file are between them
    -> give one with larger cells
geoid.wrong: the geoid file {what}: its values at the points are not those of the Earth's geoid within 30 m
    -> give undulations in metres, positive where the geoid is above the ellipsoid
heights.two_ways: more than one way to ellipsoidal heights is given
    -> give one of <geoid>, <undulation_m>, <both_heights>
heights.geocentric: geocentric coordinates have no heights above a zero level
    -> leave <geoid>, <undulation_m> and <both_heights> out
heights.ellipsoidal (note): heights are taken as ellipsoidal: {crs} says nothing of heights
heights.geoid (note): heights became ellipsoidal by the undulations of {grid}: {least:.3f} to {most:.3f} m
heights.found (note): PROJ does not find the grid of {name}: {grid} in its folders takes its place
heights.constant (note): heights became ellipsoidal by the constant undulation {undulation_m:.3f} m
heights.estimated (note): heights became ellipsoidal by the constant undulation {undulation_m:.3f} m, standard
    deviation {sigma_m:.3f} m (of one point {single_m:.3f} m), from {n} points with both heights; the standard
    deviations of the points do not contain it
heights.one_point (warning): the constant undulation {undulation_m:.3f} m comes from one point: nothing checks it
    -> give both heights of more points
heights.odd_point (warning): the undulation of this point differs from that of the others by {apart_m:+.3f} m,
    {times:.0f} times its standard deviation
    -> check its two heights
heights.odd_constant (warning): the constant undulation {undulation_m:.3f} m is {apart_m:+.1f} m from that of the
    Earth's geoid{opposite}
    -> check its sign and unit; a local zero level can differ
geodesy.outside: the coordinates lie outside the domain of {crs}
    -> check the values, the order of the columns and the CRS
table.missing_file: the file does not exist
    -> check the path; tables that a project file names are taken relative to its folder, others to the current one
table.unreadable: the file cannot be read
    -> give a readable file
table.utf16: the file is UTF-16
    -> save it as UTF-8 text with commas (in Excel: CSV UTF-8), or make a project of it: fg-orient new
table.nul: the file holds NUL bytes and is no text
    -> save the table as UTF-8 text with commas
table.not_utf8: the file is not UTF-8, perhaps Latin-1
    -> save it as UTF-8 text, or make a project of it: fg-orient new
project.encoding: the project file is not UTF-8
    -> save it as UTF-8 text
table.other_form: the name does not say which form the file has
    -> end the name of text with .csv, of Parquet with .parquet, of Arrow and Feather version 2 with .arrow or .feather
table.damaged: the file is damaged or incomplete
    -> write it again, or give the table as CSV
table.no_pyarrow: Parquet and Arrow files need pyarrow
    -> install the extra: pip install 'fg-orient[arrow]', or use CSV
table.version: the table has another version than {version}
    -> update fg_orient, or give the table as CSV
table.memory: {rows} rows of {columns} columns need more memory than {allowed}
    -> use a machine with more memory, or give less rows
table.column_type: the type of the column cannot be used
    -> write {expected}
table.text: the text has line breaks, NUL or more than {limit} characters
    -> correct the text
table.empty: the file holds no header line
    -> begin with a line that names the columns: {columns}
table.no_records: no records follow the header
    -> add at least one record
table.long_line: the line is too long for a record
    -> keep lines below {limit} characters, one record on each
table.quotes: the quotes of the line are not balanced
    -> close the quotes, or remove them
table.delimiter: the columns are not separated by commas
    -> save the table with commas and decimal points, or make a project of it: fg-orient new
table.column_twice: two columns have the same name
    -> keep one of them
table.column_unknown: unknown column
    -> {hint}
table.column_foreign: the column does not belong with the others
    -> the columns are {columns}
table.column_missing: a column is missing
    -> the columns are {columns}, in any order
table.cell_count: the line does not have one cell for each of the {count} columns
    -> write an empty cell for a missing value and decimal points, not commas
table.cell_empty: the cell is empty
    -> write a number
table.not_a_number: this is not a finite number
    -> write a number such as -12.5 or 1e-6
table.number_too_large: the number is too large for double precision
    -> write a number below 1.7e308
table.more_faults: further faults are not listed
    -> correct the errors above first
points.crs_columns: the CRS is {kind}, the coordinate columns are not
    -> name them {columns}, or change the project file's crs
points.sigma_axes: sigmas along the axes of the CRS are not supported
    -> give sigma_east_m, sigma_north_m, sigma_up_m at the point
points.id_missing: the point has no id
    -> give every point an id
points.id_twice: the id is used twice, first on {first}
    -> give every point its own id
points.role: unknown role
    -> write control, check or tie
points.no_coordinates: the {role} point has no coordinates
    -> give its coordinates, or make it a tie point
points.tie_coordinates: a tie point has no known coordinates
    -> empty the cell, or make it a control or check point
points.sigma_not_positive: the standard deviation is not above zero
    -> give it in metres; a point without uncertainty has the word fixed in all three sigma columns
points.fixed_partly: fixed stands in some sigma columns only
    -> write fixed in all three sigma columns, or in none
points.fixed_check: only a control point can be fixed
    -> give the standard deviations of the check point
points.latitude: the latitude is outside -90 .. 90 degrees
    -> check the value
points.longitude: the longitude is outside -180 .. 180 degrees
    -> check the value; 190 is written -170
points.swapped_range: longitude and latitude look swapped
    -> exchange the values of lon_deg and lat_deg
points.swapped: {first} and {second} look swapped: exchanged, the points lie in the images ({count} of {total})
    -> exchange the two columns
points.far: the point lies {distance_km:.0f} km from the centre of the nearest image ({image}, {size_km:.0f} km
    across)
    -> check the coordinates, the columns and the crs of the project file
points.changed: the file has changed since it was read
    -> run the adjustment again
observations.image_unknown: the project has no such image{times}
observations.point_unknown: the point file has no such id{times}
project.unknown_key: unknown entry
    -> {hint}
observations.twice: the point is measured twice in this image, first on {first}
    -> keep one measurement
observations.outside: the pixel lies outside image {image}
    -> {axis} runs from -0.5 to {last:g}; (0, 0) is the centre of the first pixel
observations.sigma_not_positive: the standard deviation is not above zero
    -> give it in pixels
observations.seen_once: {count} check or tie point(s) are measured in one image only, so that they have no position
    -> measure them in a second image, or write points_seen_once = "drop" under [adjustment]
observations.image_unused: no point is measured in the image
    -> measure points in it, or remove it from the project
project.missing_file: the file does not exist
    -> check the path; it is taken relative to {folder}
project.folder: this is a folder, not a project file
    -> give the project file in it, such as {inside}
project.unreadable: the file cannot be read
    -> give a readable text file
project.syntax: the project file is not valid TOML
    -> correct the line; strings stand in double quotes
project.schema: unknown schema of the project file
    -> this version reads schema = 1
project.format: files of this format hold no {what} that could be read
    -> choose one of docs/formats
project.own_table: this entry is for files of other programs only
    -> leave it out, or name their format
project.lacks: it has no {what}
    -> add {entry}
project.images_alike: two images of the file are one of the project
    -> name the id of each in the table images
project.missing: a required entry is missing
    -> add it: {expected}
project.value: the value is not allowed
    -> give {expected}
project.image_twice: the image id is used twice
    -> give every image its own id
image.adjusted (note): the adjusted orientation is used
image.attitude_starts_late (note): attitudes start later than the image by {open_s:.3f} s: extrapolated with the
    last rate by {added_s:.3f} s
image.attitude_ends_early (note): attitudes end before the image by {open_s:.3f} s: extrapolated with the last rate
    by {added_s:.3f} s
image.lines_refused (note): the attitudes do not cover lines {first} to {last}: they are refused
image.frame_without_attitudes (note): the producer computed the frame points of SPOT 1 to 4 without attitudes: with
    the attitudes they are missed by metres (up to 25 m in known files)
image.frame_without_heights (note): the file states no heights for its frame points, which lie on the terrain:
    without <height> or <dem> the height of each is solved, and the misfit is what no height explains
image.two_attitudes (note): the file holds polynomial and sampled quaternions: the polynomials are used
image.quaternion_flags (note): {count} of {n} quaternions are not flagged NOMINAL and used all the same
image.attitude_flags (note): {count} of {n} attitude samples are flagged OUT_OF_RANGE and used all the same
image.biases (note): Instrument_Biases yaw, pitch, roll = {biases_rad[0]:.6g}, {biases_rad[1]:.6g},
    {biases_rad[2]:.6g} rad are in the file and not applied
image.one_band (note): look angles of band {band} are used; other bands of the file have others
image.first_band (note): look angles of the first of {n} bands are used (BAND_INDEX {band})
image.speeds_held (note): angular speeds are held for {before_s:.3f} s before and {after_s:.3f} s after their list
image.speeds_closing (note): integrated speeds meet the last absolute attitude within {closing_microrad:.2f}
    microrad
image.earth_not_needed (note): the Earth orientation file is not needed: no frame is inertial
image.no_earth_orientation (note): no Earth orientation file: UT1 = UTC and no polar motion; neglected are at most
    {turn_m:.0f} m east-west (UT1 - UTC up to {most_s} s) and {pole_m:.0f} m (pole up to 0.6 arc seconds)
image.pole_offsets (note): pole offsets against IAU 1980 (dPsi, dEps) are left out: up to 3 cm
rpc.first_pixel_assumed (warning): profile {profile}: the first pixel is taken as ({first:g}, {first:g});
    read_rpc(first_pixel=) sets another
rpc.domain_exchanged (warning): longitude and latitude of the validity domain are exchanged in the file: put right
rpc.contradiction (warning): the file's models to the ground and to the image disagree by up to {largest_px:.1f} px;
    the latter is used
rpc.offsets_put_back (warning): OSSIM took 1 off the offsets of SPOT 6/7, which count from 0: put back
rpc.adjustment_ignored (warning): the adjustment parameters of OSSIM in the file are not applied
rpc.fitted_to_sensor (warning): fitted to a sensor: largest errors {errors_px[0]:.3f}, {errors_px[1]:.3f} px (line,
    sample) at {n} other points
rpc.compensated (note): compensated with control points
rpc.fitted_correction (note): its corrected RPC is fitted, it differs from model and compensation by up to
    {line_px:.2g} px in line, {sample_px:.2g} px in sample
points.operation (note): {operation}
points.back (note): and from there to {crs} by the inverse of {operation}
points.alone (note): left out: {n} point(s) measured in one image only
points.behind (note): behind a camera: {n} point(s)
points.not_adjusted (note): {n} unadjusted point(s) are left out
points.crs_replaced (note): the CRS of the file ({stated}) is none of EPSG: {crs} takes its place
points.columns_ignored (note): columns not read: {columns:40}
points.numbered (note): {n} points without a name are numbered in their order
points.no_track (note): left out: {n} keypoint(s) without a point
points.images_left_out (note): left out: {n} image(s) without orientation
points.matches (note): {n} {kind} matches
points.model_left_out (note): {poses} poses with {cameras} cameras and the local coordinates of {points} points are
    left out
points.sizes_assumed (note): the file holds no sizes of images: {side} x {side} pixels, out to the outermost image
    point, are assumed for {images:5}; <image_size> NAME=LINES,SAMPLES gives a size
points.latin1 (note): the file is not UTF-8: it is read as Latin-1
points.conflicts (note): {n} of {total} tie point(s) left out ({image_points} image points): their matches chain two
    places of one image, the first ({first[0]:g}, {first[1]:g}) and ({second[0]:g}, {second[1]:g}) of {image}
""")
