"""Messages about frame cameras and bundle files."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
frame.camera: this value of the camera is not possible
    -> give {expected}
frame.unknown: the camera has no such unknown, or its prior sigma is not above zero
    -> choose one of {known}
frame.nothing_unknown: the camera has no unknown, so its image cannot be adjusted
    -> name some with their prior sigmas, small ones to hold it
frame.shared: images that share the unknown under {id!r} disagree
    -> give all of them the same prior sigma and the same start value
frame.shared_not: images have unknowns in common ({id}), which this cannot do
    -> leave it out, or let each image have its unknowns for itself
frame.no_direction: the distortion of the camera cannot be inverted at this pixel
    -> check k1, k2, k3, p1, p2: the polynomial folds inside the image
frame.local: the image stands in a local coordinate system: there is no height above the ellipsoid to locate at
    -> intersect the point from two images, or give the camera in Earth-fixed coordinates
bal.unreadable: the bundle file cannot be read
    -> give a text file, plain or compressed by gzip or bzip2
bal.header: a bundle file begins with three counts: cameras, points, observations
    -> check that this is a file of Bundle Adjustment in the Large
bal.count: the counts of the first line ask for {expected} numbers in all
    -> the file is truncated or damaged: copy it again
bal.number: this is no finite number
    -> the file is damaged: copy it again
bal.index: no such camera or point
    -> cameras and points are counted from 0, here to {last}
bal.focal: the focal length is not above zero
    -> the file is damaged, or of another camera model
frame.angles: a frame image has either the angles of its camera or a rotation matrix
    -> give omega_phi_kappa_deg or rotation, and not both
sensor.toml: a sensor description or frame image must say what it is
    -> give kind = {known}
navigation.image: the project has no such image
    -> name the images as the project does
navigation.twice: the image was observed twice on board
    -> keep one record for each image
navigation.sigma: the standard deviation is not above zero
    -> give metres or degrees, as the column says
navigation.kind: only frame images in Earth-fixed coordinates take observations from on board
    -> leave the image out of the navigation table
frame.mixed: images in a local coordinate system and Earth-fixed ones cannot stand in one block
    -> transform them to one system
""")
