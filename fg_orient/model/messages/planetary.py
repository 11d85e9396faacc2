"""Messages about bodies, image support data, labels and networks of ISIS, and states of the Community Sensor Model."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
body.radii: the radii of a body must be three numbers above zero
    -> give them in metres along x, y, z
body.unknown: there is no such body
    -> give a name of the IAU such as "Moon", the code of a CRS such as "IAU_2015:30100", or three radii in metres
body.differs: the image lies on a body with other radii than the body of the project
    -> correct the entry body of the project, or leave it out
body.mixed: the images lie on different bodies
    -> adjust the images of each body in a separate project
body.light: effects on light are for images of the Earth
    -> give none
body.earth: longitude and latitude of this output refer to WGS 84, but the points lie on another body
    -> use the table points of the result folder, which has body-fixed x, y, z
body.dem: elevation models of other bodies than the Earth are not read
    -> give heights above the radii of the body
body.crs: points and images lie on different bodies
    -> give crs = "body-fixed" for x, y, z in metres, or a code of the IAU for the body of the images; an EPSG code for
    points on the Earth
pvl.missing: this value is missing
    -> add it
pvl.numbers: {count} finite number(s) expected
    -> correct the value
pvl.end: this statement ends an object or group that was not begun
    -> remove it, or add the beginning
pvl.statement: this is neither a statement "name = value" nor the end of an object or group
    -> correct the line; a text with blanks needs quotes
pvl.open: this object or group does not end
    -> add its End_Object or End_Group: the file may be cut
pvl.empty: the file contains no statement in PVL
    -> give a text in PVL; cnetbin2pvl of ISIS writes a binary network as text
isis.no_network: the file contains no object ControlNetwork
    -> give a control network; cnetbin2pvl of ISIS writes a binary network as text
isis.type: this is not a type of control points
    -> choose one of {known}
isis.covariance: the a priori covariance has a variance that is not above zero
    -> correct AprioriCovarianceMatrix: xx, xy, xz, yy, yz, zz in m2
isis.crs: a control network has body-fixed coordinates
    -> leave the CRS out, or give "body-fixed"
isis.left_out (note): left out
isis.correlated (warning): a priori coordinates are correlated along longitude, latitude and radius; the correlations
    are not used
    -> give uncorrelated standard deviations, if the correlations matter
isd.model: the camera model of the file is not of this kind
    -> give a file of the model {known}
isd.distortion: this model of distortion is not known
    -> choose one of {known}
isd.coefficients: distortion {model} needs {expected} finite coefficients
    -> correct the list of coefficients
isd.times: times must increase, and the centre time {time:.6f} must lie among them
    -> correct the times, or take all states of the image into the file
isd.size: coordinates must be below {most:g} in absolute value, in km and km/s
    -> check the unit
isd.states: a line-scan image needs two or more states
    -> write the file again with the states of all lines
isd.body_span: the rotation of the body does not cover the lines of the image, {first:.6f} .. {last:.6f} s
    -> write the file again with the rotation for all lines
isd.focal: the focal length must not be zero
    -> correct the value, mm
isd.unit: the unit of the radii must be m or km
    -> correct the unit
isd.detector: the detector has no pixels on the focal plane: its affine map cannot be inverted
    -> correct focal2pixel and the summing, which must be above zero
isd.metric (note): the distortion is read from the keywords of NAIF for a metric camera: the file states a distortion of
    zero
csm.sensor: only the rigorous model of a pushbroom image becomes a line-scan state
    -> give its metadata with states and attitudes
csm.bands: only the model of a pushbroom image is divided into bands of columns
    -> write one file: omit <bands>
csm.parameters: a state with parameters that are not zero is not read
    -> give a state in which the adjustment is applied to positions and quaternions
csm.aircraft: states of aircraft are interpolated in a way that this program does not support
    -> give the state of a satellite, m_platformFlag = 1
csm.list: two or more records of {width} numbers in steps above zero are needed
    -> write the file again: it may be cut
csm.camera: this camera is not possible: focal length and summing are above zero, m_zDirection is 1 or -1, and the
    detector has pixels
    -> correct the value
json.syntax: this is not JSON
    -> correct the place, or write the file again: it may be cut
json.object: an object in braces is expected
    -> give the file that the program wrote
json.missing: this value is missing
    -> add it
json.numbers: finite numbers expected: {expected}
    -> correct the value
json.count: a whole number from 1 to a million is expected
    -> correct the size of the image
json.text: a text is expected
    -> put it in quotes
""")
