"""Messages about sensor descriptions and the Earth's orientation."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
earth.span: the Earth orientation series covers MJD {first:.0f} .. {last:.0f} only
    -> use a C04 file that covers the image, or leave it out: UT1 = UTC then
earth.missing: orbit or attitudes are inertial, but nothing says how the Earth stands in these axes
    -> add the table [earth] to the description; in Python give the sensor an EarthRotation
earth.list_span: the list of table [{what}] covers {first:.6f} .. {last:.6f} s of the day only and is never
    extrapolated
    -> give states that cover all lines
earth.unreadable: the Earth orientation file cannot be read
    -> check the path and its permissions
earth.no_records: no records of an IERS C04 series
    -> give a C04 file with at least two days: year, month, day, MJD, x, y, UT1-UTC, ...
earth.record: this record is not one of an IERS C04 series
    -> use the file as the IERS gives it out
earth.gap: days of the series do not follow each other
    -> use the file as the IERS gives it out
earth.value: a pole coordinate beyond 1 arc second or UT1 - UTC beyond 1 s cannot be right
    -> check the units: arc seconds and seconds
earth.day: this is no day
    -> write it as "2012-01-01"
earth.period: the line period is zero or not finite
    -> give the seconds from one line to the next, below zero if time runs back
earth.camera: a camera is either a lens or a table of directions
    -> give focal_length_m, pitch_m and principal_sample, or directions alone
earth.directions: directions must cover samples 0 to {last}
    -> add the missing ones
earth.wide: the camera looks farther than a tangent of {most} from its axis
    -> check units and signs, or turn the axis by [mounting]
earth.matrix: the matrix is no rotation, or stands beside angles
    -> give either angles_deg or an orthonormal right-handed matrix
earth.order: the values must increase, and two at least are needed
    -> sort the table, remove repeated records
earth.state: the {what} must be {low:g} .. {high:g}
    -> check unit and frame (m, m/s)
earth.quaternion: a quaternion must have norm 1 within 1e-4
    -> give the scalar part first, as q0
earth.two_frames: orbit and attitudes stand in two inertial frames
    -> bring them to one
earth.seconds: times must be seconds since 0 h UTC of the day of the image
    -> subtract the day
""")
