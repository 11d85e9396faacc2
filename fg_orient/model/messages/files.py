"""Messages about files: metadata, sensors, terrain models, coordinates, tables, project files; notes of readers."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
xml.missing_file: the file does not exist
    -> check the path; it is relative to {base}
xml.not_a_file: this is a folder or a device, not a file
    -> give the metadata file itself
xml.unreadable: the file cannot be read
    -> check its permissions
limits.variable: the environment variable must contain NAME=NUMBER with a known name and a positive number
    -> known names: {known}
raster.source: the virtual raster refers to {what}
    -> let it refer to regular files of other rasters
limits.exceeded: this exceeds the limit of {limit}
    -> if you trust the file, raise the limit by the environment variable FG_ORIENT_LIMITS="{name}=NUMBER"
limits.memory: reading this file would need too much memory for its size, more than {allowed} ({factor:g} times its size
    and {more})
    -> if you trust the file, raise the limit by the environment variable FG_ORIENT_LIMITS="memory_factor=NUMBER"
xml.empty_file: the file is empty
    -> copy or download it again
xml.not_xml: the file is not XML
    -> give the metadata file (METADATA.DIM or DIM_*.XML)
xml.html: the file is an HTML page, probably an error page of a download
    -> download the metadata file again
xml.malformed: the XML is damaged
    -> copy or download the file again
xml.doctype: the file contains a DOCTYPE, which DIMAP products do not have and which can hide an attack
    -> remove it if you trust the file
xml.missing_element: element {element} is missing
xml.too_few: the file needs at least {at_least} {element}
dimap.detectors_cover: look angles must cover detectors {first} to {last} (NCOLS)
    -> use the complete metadata file of the product
xml.doubled: the element may occur only once here
    -> remove the wrong one
xml.empty: the element is empty
    -> fill it or use the original file
xml.not_plain: the element must contain a plain value without markup
xml.not_finite: this is not a finite number, or it is too large
xml.not_whole: this is not a whole number
xml.wrong_count: the element needs {expected} numbers separated by blanks
dimap.pixel_origin: this format counts pixels from 1
dimap.quaternion_norm: a quaternion must have norm 1 within {tolerance:g} over the whole image
sensor.no_field: the first and the last sample have the same viewing direction (less than {least:g} rad apart)
    -> use the original file
xml.not_a_number: this is not a number
    -> write it as 123.456 or 1.23e4
xml.decimal_comma: the number has a decimal comma
table.decimal_comma: the number has a decimal comma
    -> write a decimal point
xml.out_of_range: the value is outside the possible range {low:g} .. {high:g}{unit}
    -> check the value and its unit
xml.unit: unknown unit of a {quantity}
sensor.model: unknown kind of model
    -> choose one of {known}
xml.not_a_time: this is not a UTC time
    -> write it as 2005-03-13T05:21:07.332158Z
dimap.other_format: this is not a DIMAP product file that can be read
    -> give METADATA.DIM of a SPOT 1-5 level 1A scene, DIM_*.XML of a Pléiades 1A/1B or SPOT 6/7 sensor product, or a
       PHRDIMAP
dimap.other_version: this version of DIMAP is not read
    -> needed: DIMAP 1.1 (SPOT 1-5) or DIMAP 2.x (Pléiades 1A/1B, SPOT 6/7); newer missions: use their RPC
dimap.other_mission: this program cannot read the rigorous model of this mission
    -> needed: SPOT 1-7 or Pléiades 1A/1B; other missions: use their RPC
dimap.other_level: the image is resampled, so the file does not contain its viewing model
    -> needed: level 1A (SPOT 1-5) or the sensor product (profile PHR_SENSOR, S6_SENSOR, S7_SENSOR; PHR_DIMAP of level
       SENSOR)
dimap.rpc_file: the file contains RPC, not the rigorous model
    -> give the DIM_*.XML of the same folder, or use the RPC commands
dimap.time_order: times must increase
dimap.detector_order: detector numbers must increase
    -> sort the list or remove the repeated entry
dimap.radius: the distance from the Earth's centre must be {low:g} .. {high:g} m
    -> check unit and frame (Earth-fixed, m)
dimap.speed: the speed must be {low:g} .. {high:g} m/s
    -> check unit and frame (Earth-fixed, m/s)
dimap.quaternion_span: OFFSET and SCALE do not fit the time of the image (the scaled time is outside -{limit:g} ..
    {limit:g})
    -> check day and unit of OFFSET and SCALE (s of the day)
dimap.duration: {n_lines} lines with this period do not last from START to END ({duration:.6g} s)
    -> check LINE_PERIOD and its unit attribute, NROWS, START and END
dimap.look_angle: a viewing direction is more than 45 degrees from the axis
    -> check the look angle polynomial
dimap.speed_span: angular speeds cover {first:.3f} .. {last:.3f} s of the day, which does not cover the image; a speed
    is held for at most {hold} s
    -> use a metadata file whose angular speeds cover the image
dimap.speed_gap: the angular speeds have a gap; a speed is held for at most {hold} s
    -> use a metadata file with the complete list
dimap.anchor: the first absolute attitude is more than {hold} s outside the time range of the angular speeds
    -> use a metadata file whose angular speeds start with the absolute attitude
dimap.not_writable: this metadata cannot be written as {target}
    -> {needed}
sensor.not_rigorous: the published procedure needs the rigorous model of a pushbroom image
    -> give METADATA.DIM or DIM_*.XML; RPC images take part in adjust
sensor.ephemeris_span: the ephemeris covers {first:.6f} .. {last:.6f} s of the day only and is never extrapolated
    -> use a metadata file whose state vectors cover the image
sensor.attitude_span: the attitudes cover {first:.6f} .. {last:.6f} s of the day, {gap:.3f} s less than needed
    -> use pixels of {lines} only, or extrapolate with the last rate: <extrapolate_attitude_s> SECONDS
sensor.extrapolation: attitudes are extrapolated for 0 to {most:g} s only
    -> give the seconds that are missing, such as 0.2
sensor.missing: the file does not exist
dem.missing: the DEM file does not exist
    -> check the path
sensor.own_reader: the plugin that reads the file, {where}, raised an exception
    -> correct the plugin there; report file errors with InputError; <debug> shows the traceback
sensor.only_rpc: the file contains an RPC and not a rigorous model
    -> use its RPC (<model> rpc), or give the DIM_*.XML or METADATA.DIM of the image
sensor.pixel_outside: the pixel is outside the image
    -> lines run from {first_line:g} to {last_line:g}, samples from {first_sample:g} to {last_sample:g}; whole numbers
       are centres of pixels
sensor.ray_misses: the viewing ray does not meet the Earth at this height
    -> check the height (m, ellipsoidal)
dem.no_rasterio: reading a DEM needs rasterio
    -> install the extra: pip install 'fg-orient[geo]'
dem.no_crs: the DEM has no coordinate reference system
    -> assign one, for instance with gdal_edit -a_srs
dem.local_crs: the DEM has a local coordinate system without a place on the Earth
    -> transform the DEM to a geographic or projected CRS
dem.vertical_crs: the DEM states another vertical CRS than the given vertical CRS
    -> leave the option out, or correct the file
dem.geoid: the DEM's heights cannot be transformed to ellipsoidal heights: {reason}
    -> put the grid into PROJ's folder (projsync, PROJ_DATA), or convert the DEM to ellipsoidal heights
dem_control.sigma: the sigma of heights from a DEM is not a positive number
    -> give metres, such as 3
dem_control.both: a DEM as control and its sigma must be given together
    -> give <dem_control> and <dem_sigma>
dem_control.no_point: none of the points that need a height observation is inside the DEM
    -> use a DEM that covers the block, and a block with tie points
dem.vertical_unit: the DEM's heights are not in metres
    -> convert them to metres
dem.unreadable: the DEM cannot be read
    -> give a raster that GDAL reads
dem.implausible (warning): {count} cells have heights below {low:g} or above {high:g} m ({least:g} to {most:g}, in the
    part that was read) and are treated as nodata, although the file does not declare this
    -> declare a nodata value, for instance with gdal_edit -a_nodata
dem.cliffs (warning): cells of {height:g} m form vertical steps of up to {step:.0f} m to their neighbours, at row {row},
    column {column}. Such cells are probably an undeclared nodata value, but are used as heights
    -> if so, declare it, for instance with gdal_edit -a_nodata
dem.not_covered: a viewing ray meets nodata or comes from outside the DEM below its highest point near the ray
    -> use a DEM without holes that covers the image footprint and the terrain between the footprint and the sensor
geodesy.not_epsg: the coordinate reference system is not an EPSG code
    -> write EPSG:n, or EPSG:n+m with a vertical CRS, for instance EPSG:4979 or EPSG:32636
geodesy.unknown_crs: unknown EPSG code
    -> find the code at epsg.org; WGS84 longitude, latitude, height is EPSG:4979
geodesy.no_wkt: WKT 1, which other programs read, cannot describe this CRS
    -> give a CRS by its EPSG code
geodesy.not_spatial: the CRS does not have horizontal coordinates and a height
    -> give a geographic, projected or geocentric CRS
geodesy.axes: the axes of the CRS are not {unit}s to the east and north and metres up
    -> convert the coordinates first, for instance to EPSG:4979
geodesy.body_axes: coordinates of a body are longitude and latitude to the east and north, or a map of a sphere
    -> give a planetocentric code such as IAU_2015:30100, or "body-fixed"
geodesy.not_vertical: this is not a vertical CRS
    -> give one such as EPSG:5773 (EGM96) or EPSG:3855 (EGM2008)
geodesy.vertical_name: EPSG has no vertical CRS of this name
    -> give its code, or one of these names: {hint}
geodesy.no_operation: PROJ needs {grids} for an exact operation to WGS84
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
geoid.outside: the geoid file does not cover this point
    -> give a geoid file that covers the block
geoid.no_value: the geoid file has no value at this point
    -> give a geoid file that covers the block
geoid.too_large: the area of the points has too many cells of the geoid file
    -> give a geoid file with larger cells
geoid.wrong: the geoid file {what}: its values at the points are not those of the Earth's geoid within 30 m
    -> give undulations in metres, positive where the geoid is above the ellipsoid
heights.two_ways: more than one method for ellipsoidal heights is given
    -> give one of <geoid>, <undulation_m>, <both_heights>
heights.geocentric: geocentric coordinates do not contain heights above a zero level
    -> leave <geoid>, <undulation_m> and <both_heights> out
heights.ellipsoidal (note): heights are assumed to be ellipsoidal, because {crs} does not define heights
heights.geoid (note): ellipsoidal heights were computed with the undulations of {grid}: {least:.3f} to {most:.3f} m
heights.found (note): PROJ does not find the grid of {name}; {grid} in its folders is used instead
heights.constant (note): ellipsoidal heights were computed with the constant undulation {undulation_m:.3f} m
heights.estimated (note): ellipsoidal heights were computed with the constant undulation {undulation_m:.3f} m from {n}
    points with both heights. Its standard deviation is {sigma_m:.3f} m ({single_m:.3f} m for one point); the standard
    deviations of the points do not contain it
heights.one_point (warning): the constant undulation {undulation_m:.3f} m comes from one point, so it is not checked
    -> give both heights of more points
heights.odd_point (warning): the undulation of this point differs from the undulation of the others by {apart_m:+.3f}
    m, {times:.0f} times its standard deviation
    -> check its two heights
heights.odd_constant (warning): the constant undulation {undulation_m:.3f} m differs by {apart_m:+.1f} m from the
    undulation of the Earth's geoid{opposite}
    -> check its sign and unit; a local zero level can differ
geodesy.outside: the coordinates are outside the domain of {crs}
    -> check the values, the order of the columns and the CRS
table.missing_file: the file does not exist
    -> check the path; paths in a project file are relative to its folder, other paths to the current folder
table.unreadable: the file cannot be read
    -> give a readable file
table.utf16: the file is UTF-16
    -> save it as UTF-8 text with commas (in Excel: CSV UTF-8), or make a project of it: fg-orient new
table.nul_in_text: a text of the table contains the character NUL
    -> remove it from the id or name
table.nul: the file contains NUL bytes and is not text
    -> save the table as UTF-8 text with commas
table.not_utf8: the file is not UTF-8, perhaps Latin-1
    -> save it as UTF-8 text, or make a project of it: fg-orient new
project.encoding: the project file is not UTF-8
    -> save it as UTF-8 text
table.other_form: the end of the name does not identify the file format
    -> end the name with .csv for text, .parquet for Parquet, .arrow or .feather for Arrow and Feather version 2
table.damaged: the file is damaged or incomplete
    -> write it again, or give the table as CSV
table.no_pyarrow: Parquet and Arrow files need pyarrow
    -> install the extra: pip install 'fg-orient[arrow]', or use CSV
table.version: the table has another version than {version}
    -> update fg_orient, or give the table as CSV
table.memory: {rows} rows of {columns} columns need more memory than {allowed}
    -> use a machine with more memory, or give fewer rows
table.column_type: the type of the column cannot be used
    -> write {expected}
table.text: the text contains line breaks, NUL or outer blanks, or has more than {limit} characters
    -> correct the text
table.empty: the file has no header line
    -> begin with a line that names the columns: {columns}
table.no_records: the table has no record after the header
    -> add at least one record
table.long_line: the line is too long for a record
    -> write one record per line, with less than {limit} characters
table.quotes: the line has an opening quote without a closing quote
    -> close the quotes, or remove them
table.delimiter: the columns are not separated by commas
    -> save the table with commas and decimal points, or make a project of it: fg-orient new
table.column_twice: two columns have the same name
    -> keep one of them
table.column_unknown: unknown column
    -> {hint}
table.column_foreign: the column cannot be used together with the others
    -> the columns are {columns}
table.column_missing: column {missing} is missing
    -> the columns are {columns}, in any order
table.cell_count: the line does not have {count} cells, one for each column
    -> write an empty cell for a missing value and decimal points, not commas
table.cell_empty: the cell is empty
    -> write a number
table.not_a_number: this is not a finite number
    -> write a number such as -12.5 or 1e-6
table.number_too_large: the number is too large for double precision
    -> write a number below 1.7e308
table.more_faults: further errors are not listed
    -> correct the errors above first
points.crs_columns: the CRS is {kind}, but the coordinate columns are not
    -> name them {columns}, or change the project file's crs
points.sigma_axes: sigmas along the axes of the CRS are not supported
    -> give sigma_east_m, sigma_north_m, sigma_up_m for the point
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
points.sigma_not_positive: the standard deviation is not above zero, or its size is impossible
    -> give it in metres; a point without uncertainty has the word fixed in all three sigma columns
points.fixed_partly: only some of the three sigma columns contain the word fixed
    -> write fixed in all three sigma columns, or in none
points.fixed_check: only a control point can be fixed
    -> give the standard deviations of the check point
points.latitude: the latitude is outside -90 .. 90 degrees
    -> check the value
points.longitude: the longitude is outside -180 .. 180 degrees
    -> check the value; 190 is written -170
points.too_large: the coordinate is larger than {limit:g} m
    -> correct it
points.swapped_range: longitude and latitude look swapped
    -> exchange the values of lon_deg and lat_deg
points.swapped: {first} and {second} look swapped: after an exchange the points lie in the images ({count} of {total})
    -> exchange the two columns
points.far: the point is {distance_km:.0f} km from the centre of the nearest image ({image}, {size_km:.0f} km across)
    -> check the coordinates, the columns and the crs of the project file
points.far_most: {count} of {total} points are far from all images; this one is {distance_km:.0f} km from the centre of
    the nearest image ({image}, {size_km:.0f} km across)
    -> check that table and images belong to the same area, and check the columns and the crs of the project file
points.other_zone: the points are far from all images, but in {zone} ({name}) {count} of {total} points lie in the
    images
    -> give the CRS {zone}
points.changed: the file has changed since it was read
    -> run the adjustment again
observations.image_unknown: the project has no image with this id{times}
observations.point_unknown: the point file has no point with this id{times}
project.unknown_key: unknown entry
    -> {hint}
observations.twice: the point is measured twice in this image, first on {first}
    -> keep one measurement
observations.exchanged: line and sample look exchanged: {outside} of {total} image points are outside {images:5}; after
    an exchange all are inside
    -> exchange line and sample of the image points in {images:5}
observations.outside: the pixel is outside image {image}
    -> {axis} runs from -0.5 to {last:g}; (0, 0) is the centre of the first pixel
observations.sigma_not_positive: the standard deviation is not above zero, or its size is impossible
    -> give it in pixels
observations.seen_once: {count} check or tie point(s) are measured in one image only, which does not determine their
    position
    -> measure them in a second image, or write points_seen_once = "drop" under [adjustment]
observations.image_unused: the image has no measured point
    -> measure points in it, or remove it from the project
project.no_observations: the project has no image points
    -> measure tie points with fg-orient match, or add a table [observations] with file
project.missing_file: the file does not exist
    -> check the path; it is relative to {folder}
project.folder: this is a folder, not a project file
    -> give the project file in it, such as {inside}
project.unreadable: the file cannot be read
    -> give a readable text file
project.syntax: the project file is not valid TOML
    -> correct the line; write strings in double quotes
project.schema: unknown schema of the project file
    -> this version reads schema = 1
project.format: files of this format contain no {what} that can be read
    -> choose one of the formats in docs/formats
project.own_table: this entry is only for files of other programs
    -> leave the entry out, or name the format of the files
project.lacks: the entry has no {what}
    -> add {entry}
project.images_alike: two images of the file correspond to one image of the project
    -> name the id of each in the table images
project.missing: a required entry is missing
    -> add it: {expected}
project.value: the value is not allowed
    -> give {expected}
project.image_twice: the image id is used twice
    -> give every image its own id
image.adjusted (note): the adjusted orientation is used
image.attitude_starts_late (note): attitudes start {open_s:.3f} s after the image starts and are extrapolated by
    {added_s:.3f} s with the last rate
image.attitude_ends_early (note): attitudes end {open_s:.3f} s before the image ends and are extrapolated by
    {added_s:.3f} s with the last rate
image.lines_refused (note): the attitudes do not cover lines {first} to {last}, so these lines cannot be used
image.frame_without_attitudes (note): the producer computed the frame points of SPOT 1 to 4 without attitudes. Points
    computed with the attitudes therefore differ from them by metres (up to 25 m in known files)
image.frame_without_heights (note): the file states no heights for its frame points, which lie on the terrain: without
    <height> or <dem> the height of each frame point is estimated, and the misclosure is the part that remains at the
    best height
image.two_attitudes (note): the file contains polynomial and sampled quaternions: the polynomials are used
image.quaternion_flags (note): {count} of {n} quaternions are not flagged NOMINAL, but are still used
image.attitude_flags (note): {count} of {n} attitude samples are flagged OUT_OF_RANGE, but are still used
image.biases (note): Instrument_Biases yaw, pitch, roll = {biases_rad[0]:.6g}, {biases_rad[1]:.6g}, {biases_rad[2]:.6g}
    rad are in the file, but are not applied
image.one_band (note): the look angles of band {band} are used; the file has different look angles for other bands
image.first_band (note): the look angles of the first of {n} bands (BAND_INDEX {band}) are used
image.speeds_held (note): angular speeds are held constant for {before_s:.3f} s before and {after_s:.3f} s after their
    list
image.speeds_closing (note): the integrated angular speeds differ from the last absolute attitude by
    {closing_microrad:.2f} microrad
image.earth_not_needed (note): the Earth orientation file is not needed, because no frame is inertial
image.no_earth_orientation (note): without an Earth orientation file UT1 = UTC and no polar motion are assumed. The
    neglected effects are at most {turn_m:.0f} m east-west (UT1 - UTC up to {most_s} s) and {pole_m:.0f} m (pole up to
    0.6 arc seconds)
image.pole_offsets (note): pole offsets against IAU 1980 (dPsi, dEps) are neglected; their effect is at most 3 cm
rpc.first_pixel_assumed (warning): profile {profile}: the first pixel is assumed to be ({first:g}, {first:g});
    read_rpc(first_pixel=) changes this
rpc.domain_exchanged (warning): longitude and latitude of the validity domain are exchanged in the file; this is
    corrected
rpc.contradiction (warning): the file's models to the ground and to the image differ by up to {largest_px:.1f} px; the
    model to the image is used
rpc.offsets_put_back (warning): OSSIM subtracted 1 from the offsets of SPOT 6/7, which already count from 0; this is
    corrected
rpc.adjustment_ignored (warning): the adjustment parameters of OSSIM in the file are not applied
rpc.fitted_to_sensor (warning): the RPC is fitted to a sensor; the largest errors are {errors_px[0]:.3f},
    {errors_px[1]:.3f} px (line, sample) at {n} other points
rpc.compensated (note): the RPC is compensated with control points
rpc.fitted_correction (note): the corrected RPC is fitted; it differs from model and compensation by up to
    {line_px:.2g} px in line, {sample_px:.2g} px in sample
points.operation (note): {operation}
points.back (note): then transformed to {crs} by the inverse of {operation}
points.alone (note): left out: {n} point(s) measured in one image only
points.behind (note): {n} point(s) lie behind a camera
points.not_adjusted (note): {n} unadjusted point(s) are left out
points.crs_replaced (note): the CRS of the file ({stated}) has no EPSG code; {crs} is used instead
points.columns_ignored (note): these columns are not read: {columns:40}
points.numbered (note): {n} points have no name and get the numbers of their order as names
points.no_track (note): left out: {n} keypoint(s) without a point
points.images_left_out (note): left out: {n} image(s) without orientation
points.matches (note): {n} {kind} matches
points.model_left_out (note): the model is left out: {poses} poses, {cameras} cameras and the local coordinates of
    {points} points
points.sizes_assumed (note): the file contains no image sizes: {side} x {side} pixels, which include the outermost
    image point, are assumed for {images:5}; give the true sizes by <image_size> NAME=LINES,SAMPLES
points.latin1 (note): the file is not UTF-8: it is read as Latin-1
points.conflicts (note): {n} of {total} tie point(s) left out ({image_points} image points): their matches connect two
    different pixels of one image, the first ({first[0]:g}, {first[1]:g}) and ({second[0]:g}, {second[1]:g}) of {image}
""")
