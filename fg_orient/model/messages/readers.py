"""Notes of readers: what a user should know about a file that was read, an image, or points from elsewhere."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
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
points.alone (note): {n} point(s) measured in one image only are left out
points.behind (note): {n} point(s) begin behind a camera
points.not_adjusted (note): {n} point(s) that were not adjusted are left out
points.crs_replaced (note): the CRS of the file ({stated}) is none of EPSG: {crs} takes its place
points.columns_ignored (note): columns not read: {columns:40}
points.numbered (note): {n} points without a name are numbered in their order
points.no_track (note): {n} keypoint(s) without a point are left out
points.images_left_out (note): {n} image(s) without orientation are left out
points.matches (note): {n} {kind} matches
points.model_left_out (note): {poses} poses with {cameras} cameras and the local coordinates of {points} points are
    left out
points.sizes_assumed (note): the file holds no sizes of images: {side} x {side} pixels, out to the outermost image
    point, are assumed for {images:5}; <image_size> NAME=LINES,SAMPLES gives a size
points.conflicts (note): {n} of {total} tie point(s) left out ({image_points} image points): their matches chain two
    places of one image, the first ({first[0]:g}, {first[1]:g}) and ({second[0]:g}, {second[1]:g}) of {image}
""")
