"""Messages about tables of unknown form, of the command new and of the format office."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
office.question: the data do not determine {subject} ({reason})
    + : {choices}
    -> give it: {option} {example}
office.assumed (note): assumed: {subject}: {seen} ({reason})
office.in_project: a project cannot read tables of unknown form
    -> convert the tables first: fg-orient new, or fg-orient convert
office.unconfirmed: {count} assumption(s) are not confirmed
    -> read the assumptions, and add <yes>, or give the options that they name
office.workbook: the file is not a workbook, or it is damaged or encrypted
    -> open the file in a spreadsheet program and save it as .xlsx or .ods, without password
office.old_workbook: this is the workbook format used before 2007
    -> save it as .xlsx or .ods
office.no_openpyxl: Excel workbooks need openpyxl
    -> install the extra: pip install 'fg-orient[office]'
office.too_large: the table is too large to be read
    -> save only the rows of the points
office.layer: the file does not contain readable layers of points
    -> export it again as points
office.not_text: this is not text in a known encoding
    -> save it as UTF-8, or as .xlsx
office.many_files: the folder has too many files
    -> name the files of the project
office.no_numbers: the file has no rows of numbers
    -> give a table with one point on each row
office.no_record: the row has no numbers, but rows before and after it have numbers
    -> remove the row, or fill its cells
office.row_width: the row has more cells than the header ({width})
    -> check separators and quotes; with decimal commas, use a separator that is not a comma
office.not_a_number: the cell is not a number in the notation of the other cells of the table
    -> correct it
office.columns_alike: several columns look like {key}
    -> choose one: <columns> {example}
office.key: unknown key of a column
    -> {hint}
office.no_column: no table has a column of this name
    -> {hint}
office.no_ids: no column contains the ids of the points
    -> give the column: <columns> id=HEADER
office.half: only one coordinate has a column
    -> give the column of {key}: <columns> {key}=HEADER
office.pairs: the columns of lines and samples cannot be paired
    -> use names of the same form for all images, or give: <columns> line=HEADER,sample=HEADER
office.no_columns: the columns do not belong to ground points or image points
    -> give the columns: <columns> id=HEADER,E=HEADER,N=HEADER,H=HEADER or image=,id=,line=,sample=; or name the files
       to use
office.not_geocentric: these are not geocentric coordinates, in m, of points near the Earth's surface
    -> give the columns: <columns> E=HEADER,N=HEADER,H=HEADER
office.nowhere: the points are not in any image, with any order of the columns and any CRS used in that area
    -> check that images and table belong to the same area; give <crs> and <columns>
office.nowhere_in_crs: the points are not in any image in the stated CRS, with any order of the columns
    + ; they are in {others:3}
    -> check the CRS, and that images and table belong to the same area; without a statement the CRS used in that area
       are tried
office.no_fit: no interpretation of the table fits the images; the best interpretation is
    -> give <crs>, <columns> and <units>; check the ids, and check that lines and samples belong to these images
office.outside: the image point is outside the image {image}
    -> check that the table belongs to this image in full size, not to a part or a reduced copy; or give <first_pixel>
       and <columns>
office.image_unknown: the table names an image that cannot be assigned: {known}
    -> give the image: <image> NAME_IN_TABLE=IMAGE
office.shared_ids: another table of image points has the same ids
    -> give different points different ids, or join the tables
office.same_image: the tables use two names for the image {image}
    -> name the files to use, or assign the names: <image> NAME_IN_TABLE=IMAGE
office.no_common: ground points and image points have no id in common
    -> give the columns of the ids: <columns> id=HEADER
office.two_places: the point has different coordinates in another table
    -> give every point its own id, or leave one of the tables out
office.other_columns: the columns of this table of ground points differ from the columns of the first table
    -> give the files to use instead of the folder
office.role: unknown role
    -> write control, check or tie; or read without it: <role_column> none
office.value: this value is not understood
    -> write it as {expected}
office.no_images: no file contains the metadata or RPC of an image
    -> give the files or their folder
""")
