"""Messages about the program: installation, command line, plugins, outputs."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
installation.overwritten: this file of fg_orient was overwritten by the distribution {owner}, which also has a package
    'factors'
    -> pip uninstall {name}, and then pip install --force-reinstall --no-deps {source}, in this order; only one of the
       two can be installed in an environment
installation.damaged: this file of fg_orient is missing or changed, probably because another package 'factors' was
    uninstalled
installation.other_version: this package 'factors' belongs to fg_orient {other}, the other packages to {version}
    -> pip install --force-reinstall --no-deps {source}
installation.damaged_tree: this file of fg_orient's source tree is missing or changed
    -> restore it from the repository (git checkout factors), or install again from it
installation.other_distribution: the package 'factors' of the distribution {owner} hides the package of fg_orient in
    {ours}
    -> pip uninstall {name}, or install fg-orient into a separate environment
installation.on_pythonpath: this hides the package 'factors' of fg_orient in {ours}, because its folder is in
    PYTHONPATH
    -> remove {root} from PYTHONPATH, or rename it
installation.user_file: this file hides the package 'factors' of fg_orient in {ours}
    -> give the file a name that is not the name of a package, such as {new}
installation.user_folder: this folder hides the package 'factors' of fg_orient in {ours}
    -> rename or remove the folder, or start Python where it is not on the search path
path.nul: the path contains NUL, so no file can have it
    -> check the path
path.encoding: the path is not UTF-8, so no record can name it
    -> rename the folder or file, or start the program in that folder and give the rest of the path
path.long_name: a name in the path is too long for a file
    -> give a name of at most {limit} bytes
path.long: the path is too long
    -> give a path of at most {limit} bytes
output.exists: the output exists already
    -> give another {option} or add <overwrite>
output.busy: another run is writing this file
    -> wait until that run has ended
output.not_a_file: this is a pipe, a device or a link without target, so it is not replaced
    -> give the name of a file
output.is_input: the output would replace an input of the same command
    -> give another {option}
output.not_a_folder: this is not a folder, or it is a link to one
replay.same_folder: the repeated run would replace the result that it repeats
    -> give another <out>
output.foreign: the folder contains other files, so it is not replaced
    -> give another <out>, or move them; <overwrite> replaces only a folder that contains {mark} and no other files
output.unwritable: the file cannot be written
    -> check folder, permissions and free space
replay.record: the result does not contain the data to repeat its run
    -> the result is damaged or was written by an older version: run fg-orient adjust again
replay.project: the project file of this result is not in a folder above it or beside it
    -> give it: <project> FOLDER/{name}
replay.dem: the elevation model of this run is not in the project's folder
    -> copy the elevation model there, or make a link
replay.changed: the file has changed since the run: SHA-256 {now}, recorded {then}
    -> restore the file of the run, or add <allow_changed> to continue with the changed file
replay.missing: the run read this file, but the file is now missing or no longer in the project
    -> restore the file, or add <allow_changed> to continue without it
replay.new: the run did not read this file
    -> restore the project of the run, or add <allow_changed> to continue with this file
program.memory: the memory is not sufficient, and nothing was written
    -> end other programs, take a machine with more memory, or a smaller block; an adjustment needs less in parts
       (docs/parallel.md) or with <memory_limit_gb>
internal: error of the program: {kind}: {text}
    -> please report it{hint}
plugin.file: there is no Python file of this name
    -> give a file such as my_sensor.py, whose name can be a module name
plugin.name: another module has this name already
    -> rename the file
plugin.raised: the plugin raised an exception
    -> correct the plugin there; report file errors with InputError; <debug> shows the traceback
plugin.failed: the plugin cannot be loaded
    -> correct the file; import it in Python to see the details
cli.no_pixel: no pixel is given
    -> give <line> L <sample> S, or <points> FILE, or <frame>
cli.no_height: no height is given
    -> give <height> H (m, ellipsoidal) or <dem> FILE, or a column height_m in the points file
cli.height_range: the height is outside {low:g} .. {high:g} m
    -> give an ellipsoidal height in m
cli.two_heights: the height is given twice
    -> give only one of <height>, <dem> and a column height_m
cli.two_ways: these options exclude each other
    -> give only one of {options}
cli.no_ground: no ground point is given
    -> give <lon>, <lat> and <height>, or <points> FILE
cli.pixel: this is not a pixel
    -> write <pixel> LINE,SAMPLE, for instance <pixel> 5999.5,120
cli.pixel_count: {pixels} pixel(s) for {images} image(s)
    -> give one <pixel> per image, in order
cli.one_image: an intersection needs at least two images
    -> give several metadata files, or one project file (.toml)
cli.one_project: only one project file can be checked at a time
    -> check the files one after the other; for several files of points add <format> NAME
cli.no_frame: the file contains no frame points
    -> locate a pixel with <line> and <sample>
log.foreign: the file is not a log of fg-orient, so nothing is appended
    -> give <log> the name of a new file, or of a log that fg-orient wrote
cli.no_schema: there is no command of this name that prints JSON
    -> {hint}
cli.shell: completion is not available for this shell
    -> choose one of {known}
environment.value: the environment variable has an impossible value
    -> unset it, or give {expected}
cli.usage: {text}
    -> see the command's <help>
report.no_result: the folder contains no result of an adjustment
    -> give a folder that fg-orient adjust wrote
report.nothing_adjusted: nothing was adjusted, so there are neither coordinates nor an orientation
    -> read report.html in the folder: it names the undetermined directions and the remedy
report.damaged: the result cannot be read
    -> run fg-orient adjust again
manifest.incomplete: the folder is only a part of a result: {count} of {n} file(s) are missing or too short
    -> copy the whole folder again
manifest.other_run: the record and the manifest of the folder belong to different runs
    -> copy the whole folder of one run
manifest.changed: the run did not write this file: it was edited, or belongs to another run
    -> restore the file, or run the command again
manifest.added: the run did not write this file
    -> move it to another folder
manifest.outside: this is a link out of the result folder, or not a file
    -> copy the file itself into the folder
manifest.later: the folder was written by a later version of fg_orient; this version reads manifests up to schema
    {known}
    -> update fg_orient
manifest.damaged: the manifest of the result cannot be read
    -> copy the whole folder again
report.no_matplotlib: figures need matplotlib
    -> install the extra: pip install 'fg-orient[report]'
report.no_map: the result has no geographic coordinates
    -> only blocks on the Earth can be exported as layers
report.no_pyogrio: a GeoPackage needs pyogrio and shapely
    -> install the extra: pip install 'fg-orient[geo]', or give a .geojson
report.export_suffix: this file is neither GeoPackage nor GeoJSON
    -> end its name with .gpkg or .geojson
cloud.suffix: the end of the name does not identify a format of points
    -> end the name with one of {known}
cloud.no_laspy: LAS and LAZ need laspy and lazrs
    -> install the extra: pip install 'fg-orient[cloud]', or give a .ply, .csv or .gpkg
cloud.no_points: no point is left to write
    -> give other limits, or adjust with tie or check points
report.no_truth: the folder contains no true values of a simulation
    -> give the folder "truth" written by fg-orient simulate
report.other_truth: the true values belong to another project
    -> give the true values of these images and points
""")
