"""Messages about tie points, cameras and bundles of other programs."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
lost.model: {format} cannot hold all of the model
    -> keep a file that holds it
lost.single: {format} holds single precision: pixels are rounded
    -> keep a file that holds them
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
micmac.cells: the line is not {header}
    -> give the tables of MicMac's tie points as they are
micmac.twice: the point occurs twice in this image
    -> remove the wrong one
micmac.name: the name does not tell the image, or tells one twice
    -> name each table PMUL-IMAGE.csv
bundle.cells: the line does not hold what Bundler writes here
    -> needed: {needed}
bundle.lines: the counts of the second line ask for {expected} lines in all
    -> the file is truncated or damaged: copy it again
bundle.list: the list has fewer images than the bundle ({last} at least)
    -> give the list of this bundle
bundle.camera: the camera has coefficients that the files of Bundler and BAL do not have
    -> needed: k1 and k2 alone; write a text model of COLMAP
photomodeler.cells: the line does not hold what PhotoModeler writes here
    -> needed: {needed}
photomodeler.mark: a mark of a photo or point that the export does not hold
    -> export the whole project
photomodeler.part: this part of the export is missing
    -> export the whole project
photomodeler.twice: the point is marked twice in this photo
    -> remove the wrong mark
dbat.order: no comment tells the order of the cells
    -> begin the file with a line such as: # image id, point id, x, y, sxy
dbat.cells: the line does not hold the cells that it should
    -> needed: {needed}
dbat.twice: this occurs twice
    -> remove the wrong one
colmap.database: the file is no database of COLMAP, or damaged
    -> give database.db
colmap.blob: the record does not hold what its size says
    -> the database is damaged: copy or make it again
colmap.cells: the line does not hold what COLMAP writes here
    -> needed: {needed}
colmap.model: this camera model has no counterpart here
    -> needed: one of {known}
colmap.camera: the camera has a parameter that Brown's polynomial with one focal length does not have
    -> needed: fx = fy, k4 = k5 = k6 = 0; undistort the images or calibrate with another model
colmap.reference: the {kind} is not in {other}
    -> take the files of one and the same model
colmap.twice: the {kind} occurs twice
    -> remove the wrong one
colmap.track: the tracks hold {n_tracks} image points, images.txt refers to {n_images}
    -> take the files of one and the same model
""")
