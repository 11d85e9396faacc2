"""Messages about tables of unknown form, of the command new and of the format office."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
office.question: nothing decides on {subject} ({reason})
    + : {choices}
    -> say it: {option} {example}
office.assumed (note): assumed: {subject}: {seen} ({reason})
office.in_project: a project does not read tables of unknown form
    -> make its tables from them: fg-orient new, or fg-orient convert
office.unconfirmed: {count} assumption(s) are not confirmed
    -> read them, and add <yes>, or give the options that they name
office.workbook: the workbook is damaged, encrypted or none
    -> open it in a spreadsheet program and save it again as .xlsx or .ods, without password
office.old_workbook: this is the workbook format of before 2007
    -> save it as .xlsx or .ods
office.no_openpyxl: Excel workbooks need openpyxl
    -> install the extra: pip install 'fg-orient[office]'
office.too_large: the table is too large to be read whole
    -> save the rows of the points alone
office.layer: the file cannot be read as layers of points
    -> export it again as points
office.not_text: this is no text of a known encoding
    -> save it as UTF-8, or as .xlsx
office.many_files: the folder has too many files
    -> name the files of the project
office.no_numbers: the file has no rows of numbers
    -> give a table with one point on each row
office.no_record: the row has no numbers, rows before and after it have
    -> remove it, or fill its cells
office.row_width: the row has more cells than the header ({width})
    -> check separators and quotes; decimal commas need another separator than the comma
office.not_a_number: the cell is no number in the way that the others of its table are written
    -> correct it
office.columns_alike: several columns look like {key}
    -> say which one: <columns> {example}
office.key: no such key of a column
    -> {hint}
office.no_column: no table has this column
    -> {hint}
office.no_ids: no column holds the ids of the points
    -> say which one: <columns> id=HEADER
office.half: there is a column for one coordinate only
    -> say which column is {key}: <columns> {key}=HEADER
office.pairs: the columns of lines and samples do not make pairs
    -> name the columns of the images alike, or say: <columns> line=HEADER,sample=HEADER
office.no_columns: the columns are neither those of ground points nor of image points
    -> say which they are: <columns> id=HEADER,E=HEADER,N=HEADER,H=HEADER or image=,id=,line=,sample=; or name the
    files to use
office.not_geocentric: these are no geocentric coordinates of points near the surface of the Earth, in m
    -> say which columns they are: <columns> E=HEADER,N=HEADER,H=HEADER
office.nowhere: the points lie in no image, in any order of the columns and in no CRS that is used there
    -> check that images and table are of one place; give <crs> and <columns>
office.no_fit: no reading of the table fits the images; the best one is
    -> give <crs>, <columns> and <units>; check ids, and that lines and samples are those of these images
office.outside: the image point lies outside the image {image}
    -> check that the table is of this image, whole and not reduced; or say <first_pixel> and <columns>
office.image_unknown: the table names an image that cannot be assigned: {known}
    -> say it: <image> NAME_IN_TABLE=IMAGE
office.shared_ids: another table of image points has the same ids
    -> give points that differ ids of their own, or join the tables
office.same_image: tables name the image {image} in two ways
    -> name the files to use, or say which is which: <image> NAME_IN_TABLE=IMAGE
office.no_common: ground points and image points have no id in common
    -> say which columns hold the ids: <columns> id=HEADER
office.two_places: the point has other coordinates in another table
    -> give every point its own id, or leave one of the tables out
office.other_columns: this table of ground points has other columns than the first one
    -> name the files to use, instead of the folder
office.role: the word is no known role
    -> write control, check or tie; or read without it: <role_column> none
office.value: not understood
    -> write it as {expected}
office.no_images: no file holds the metadata or RPC of an image
    -> name the files or a folder with them
""")
