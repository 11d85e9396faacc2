"""Read a block from a project file, which is a TOML file, and from the files that it names.

One error reports all faults of all files. ``docs/file-formats.md`` describes the format.
Paths are relative to the project file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

from fg_orient.formats.assemble import assemble, geometry_remarks
from fg_orient.formats.body_checks import require_body, require_crs
from fg_orient.formats.faults import Faults
from fg_orient.formats.foreign import Table, read_foreign_observations, read_foreign_points
from fg_orient.formats.heights import ZeroLevel
from fg_orient.formats.points import (
    LOSES_IDS,
    ObservationFile,
    PointFile,
    no_points,
    read_observations,
    read_points,
)
from fg_orient.formats.registry import format_named
from fg_orient.formats.scenes import Scene
from fg_orient.formats.schema import (
    ImageEntry,
    ObservationsEntry,
    PointsEntry,
    ProjectFile,
    constraints_of,
    validate,
)
from fg_orient.formats.text_files import sha256_of
from fg_orient.formats.toml import parse_toml
from fg_orient.geodesy import crs_kind
from fg_orient.geodesy.crs import with_codes
from fg_orient.model.block import Block, Image, Options, Source
from fg_orient.model.constraint import foreign_members
from fg_orient.model.declaration import declared, require_declared
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.names import Role
from fg_orient.model.options import Reading
from fg_orient.model.parameters import chosen_datum, eop_set_number

#: Name of the format of our own tables.
OWN: Final = "csv"
#: Entries of [points] that are allowed only for our own table.
OWN_POINTS: Final = {"crs", "latitudinal", *ZeroLevel.__dataclass_fields__}
#: Default entry [observations] of a project that contains only images so far.
NEW_OBSERVATIONS: Final = {"file": "observations.csv"}
#: Only ``validate`` reports this remark. The adjustment gives the same warning about the points that it uses.
FEW_CHECK_CODE: Final = "remark.few_check"


def read_project(path: str | Path, **overrides: object) -> Block:
    """Read a project file and all files that it names.

    Parameters
    ----------
    path : str or Path
        The TOML file.
    **overrides
        Options that replace options of the file (docs/options.md).
        None keeps the option of the file.

    Returns
    -------
    Block
        Images, points, observations and options. ``sources`` contains the SHA-256 of each
        file, ``notes`` contains the remarks of the readers.

    Raises
    ------
    InputError
        The files have faults; the error contains one problem for each fault.
    TypeError
        The name of an override is not the name of an option.

    Examples
    --------
    >>> import fg_orient as fg
    >>> block = fg.read_project("zonguldak/project.toml", eop_set="PUA")  # doctest: +SKIP
    """
    return read_project_with_remarks(path, **overrides)[0]


def read_project_with_remarks(path: str | Path, **overrides: object) -> tuple[Block, tuple[Finding, ...]]:
    """Read a block as :func:`read_project` does; also return the remarks as records."""
    path = Path(path)
    project = _read_toml(path, overrides)
    options, problems = _options(project, str(path), overrides)
    folder = path.parent
    images, image_problems = _images(project, folder, str(path))
    own_crs = project.points.crs if project.points.format == OWN else None
    require_crs(images.values(), own_crs or "", str(path))
    points, observations, table_problems = _tables(project, folder, str(path), images)
    constraints, constraint_problems = constraints_of(project.constraints, str(path), surplus=1)
    problems += [*image_problems, *table_problems, *constraint_problems]
    if problems or points is None or observations is None:
        raise InputError(*problems)
    require_crs(images.values(), points.system.crs, str(path))
    known = tuple(image for image in images.values() if image is not None)
    drop = project.values_of(Reading)["points_seen_once"] == "drop"
    ids, control = [image.id for image in known], bool(points.points.where(Role.CONTROL).size)
    relative = project.lines is not None or chosen_datum(options, known, control=control) != "control"
    named = {name for c in constraints for name in c.members}
    kept, measured, withheld, left_out = assemble(ids, points, observations, drop=drop, relative=relative, named=named)
    foreign = foreign_members(constraints, kept.ids, ids, str(path))
    if foreign:
        raise InputError(*foreign)
    geometry = geometry_remarks(known, kept, measured, str(points.path))
    remarks = (*points.remarks, *observations.remarks, *left_out, *geometry)
    files = (path, *(folder / entry.metadata for entry in project.images))
    block = Block(
        name=project.name,
        images=known,
        points=kept,
        observations=measured,
        withheld=withheld,
        options=options,
        sources=(
            *(Source(str(file), sha256_of(file)) for file in files),
            *(Source(str(table.path), table.sha256) for table in (points, observations) if table.sha256),
            *(Source(str(file), sha256_of(file)) for file in ZeroLevel.of(project.points, folder).files),
        ),
        notes=_notes(known, points, [p for p in remarks if p.code != FEW_CHECK_CODE]),
        ground=points.system,
        extra=constraints,  # type: ignore[arg-type]  # the adjustment makes observations of them
    )
    if project.points.latitudinal:
        from fg_orient.sensors.latitudinal import with_angles

        block = with_angles(block)
    block = _navigated(block, project, folder, str(path))
    if project.lines is not None:
        from fg_orient.formats.lines import lined

        block = lined(block, project.lines, folder, str(path))
    return block, remarks


class ProjectImages(NamedTuple):
    """Images of a project with their entries, its options and tables, and whether the file names image points."""

    name: str
    images: tuple[Image, ...]
    entries: tuple[ImageEntry, ...]
    options: Options
    points: PointsEntry
    observations: ObservationsEntry
    is_new: bool


def has_observations(path: str | Path) -> bool:
    """Return whether a project file names image points."""
    return "observations" in parse_toml(Path(path))


def read_images(path: str | Path, **overrides: object) -> ProjectImages:
    """Read the images and options of a project; ``overrides`` replace options of the file.

    The tables of points and observations may be missing, both in the project file and on the disk.

    Raises
    ------
    InputError
        The project file or the metadata have faults.
    """
    path, is_new = Path(path), not has_observations(path)
    project = _read_toml(path, overrides, {"observations": dict(NEW_OBSERVATIONS)})
    options, problems = _options(project, str(path), overrides)
    images, image_problems = _images(project, path.parent, str(path))
    problems += [*image_problems, *_entry_problems(project, str(path))]
    if problems:
        raise InputError(*problems)
    known = tuple(image for image in images.values() if image is not None)
    return ProjectImages(project.name, known, project.images, options, project.points, project.observations, is_new)


def checked_project(path: str | Path, **overrides: object) -> tuple[Block | None, list[Finding]]:
    """Read a project with all its files and list its errors or remarks.

    Parameters
    ----------
    path : str or Path
        The project file.
    **overrides
        Options as for :func:`read_project`.

    Returns
    -------
    block : Block or None
        None if there are errors.
    problems : list of Finding
        Errors that would make ``adjust`` refuse the project, or notes. Empty if there are neither
        errors nor notes.
    """
    try:
        block, remarks = read_project_with_remarks(path, **overrides)
    except InputError as error:
        return None, list(error.problems)
    return block, list(remarks)


def require_files(path: str | Path, **overrides: object) -> Options:
    """Refuse a project that names a missing file; return its options, which the overrides replace.

    This check is done before the modules of the sensors are loaded, which takes time.

    Raises
    ------
    InputError
        The project file has errors, or a file is missing. All missing files and the errors of
        the tables are listed.
    """
    path = Path(path)
    project = _read_toml(path, overrides)
    problems = list(filter(None, (_missing(project, k, path) for k in range(len(project.images)))))
    tables = [table.file for table in (project.points, project.observations) if table.file]
    if problems or not all((path.parent / name).exists() for name in tables):
        problems += _tables(project, path.parent, str(path), {})[2]
    if problems:
        raise InputError(*problems)
    return _options(project, str(path), overrides)[0]


def _missing(project: ProjectFile, k: int, path: Path) -> Finding | None:
    """Return the error of image k if its metadata file does not exist."""
    name = project.images[k].metadata
    if (path.parent / name).is_file():
        return None
    place = f"images[{k + 1}].metadata"
    return finding("project.missing_file", file=path, place=place, value=name, folder=path.parent)


def _navigated(block: Block, project: ProjectFile, folder: Path, file: str) -> Block:
    """Add the positions and attitudes that were observed on board, if the project names them."""
    entry = project.navigation
    if entry is None:
        return block
    from fg_orient.formats.navigation import mounting_of, read_navigation
    from fg_orient.sensors.navigation import with_navigation

    path = folder / entry.file
    if not path.is_file():
        raise InputError.of("project.missing_file", file=file, place="navigation.file", value=entry.file, folder=folder)
    try:
        crs_kind(with_codes(entry.crs))
    except InputError as error:
        raise InputError(*(replace(p, file=file, place="navigation.crs") for p in error.problems)) from None
    fixes, sha256 = read_navigation(path, entry.crs)
    try:
        block = with_navigation(block, fixes, mounting_of(entry))
    except InputError as error:
        raise InputError(*(replace(p, file=str(path)) for p in error.problems)) from None
    return replace(block, sources=(*block.sources, Source(str(path), sha256)))


# --- the TOML file -------------------------------------------------------------------------------


def _read_toml(path: Path, overrides: Mapping[str, object], missing: Mapping[str, object] | None = None) -> ProjectFile:
    """Read the file; ``missing`` are tables that it need not have."""
    require_declared(overrides, "read_project", Options, Reading)
    content = {**(missing or {}), **parse_toml(path)}
    for name, value in overrides.items():
        if value is not None:
            table = content.setdefault(_table_of(name), {})
            if isinstance(table, dict):
                table[name] = value
    try:
        return validate(content, str(path), ProjectFile)
    except InputError as error:
        raise InputError(*(_blame(p, overrides) for p in error.problems)) from None


def _table_of(name: str) -> str:
    """Return the name of the project file's table that contains an option."""
    return declared(Options, Reading)[name].group.table


def _blame(fault: Finding, overrides: Mapping[str, object]) -> Finding:
    """Return a fault that names the overriding option, or the next step of a project without points."""
    if (fault.code, fault.place) == ("project.missing", "observations"):
        return finding("project.no_observations", file=fault.file, place=fault.place)
    for name, value in overrides.items():
        place = f"{_table_of(name)}.{name}"
        if value is not None and (fault.place == place or fault.place.startswith(f"{place}[")):
            fault = replace(fault, file="", option=name, place=fault.place.removeprefix(place))
    return fault


def _options(project: ProjectFile, file: str, overrides: Mapping[str, object]) -> tuple[Options, list[Finding]]:
    """Return the options of the block; note faults that the schema cannot detect."""
    problems: list[Finding] = []
    values = project.values_of(Options)
    try:
        values["eop_set"] = eop_set_number(values["eop_set"])
    except InputError as error:
        values["eop_set"] = Options.eop_set
        problems += [replace(p, file=file, option="", place="orientation.eop_set") for p in error.problems]
    ids = [entry.id for entry in project.images]
    for k, name in enumerate(ids):
        if name in ids[:k]:
            problems.append(finding("project.image_twice", file=file, place=f"images[{k + 1}].id", value=name))
    return Options(**values), [_blame(p, overrides) for p in problems]


# --- the files it names --------------------------------------------------------------------------


def _images(project: ProjectFile, folder: Path, file: str) -> tuple[dict[str, Image | None], list[Finding]]:
    """Read the images and return them by id, with the errors; None if a metadata file cannot be used."""
    import fg_orient.formats.sensor as sensor_reader

    images: dict[str, Image | None] = {}
    problems: list[Finding] = []
    read = project.values_of(Reading)
    how = {"extrapolate_attitude_s": read["extrapolate_attitude_s"], "light": tuple(read["light"])}
    for k, entry in enumerate(project.images):
        images.setdefault(entry.id, None)
        missing = _missing(project, k, Path(file))
        if missing is not None:
            problems.append(missing)
            continue
        try:
            sensor = sensor_reader.read_sensor(folder / entry.metadata, **how)
            pixels = "" if entry.pixels is None else str(folder / entry.pixels)
            require_body(project.body, sensor, file)
            images[entry.id] = Image(entry.id, sensor, pixels, entry.pixels_origin, entry.held)
        except InputError as error:
            problems += error.problems
    return images, problems


def _tables(
    project: ProjectFile, folder: Path, file: str, images: Mapping[str, Image | None]
) -> tuple[PointFile | None, ObservationFile | None, tuple[Finding, ...]]:
    """Read the points, then the observations; compare their ids, and return the faults of both."""
    observation_path = folder / project.observations.file
    point_path = folder / project.points.file if project.points.file else observation_path
    point_faults, observation_faults = Faults(str(point_path)), Faults(str(observation_path))
    points, crs_problems = None, _entry_problems(project, file)
    ties = not project.points.file
    if ties:
        points = no_points(point_path)
    elif not crs_problems:
        scenes = _scenes(images, (point_path, observation_path))
        if project.points.format == OWN:
            level = ZeroLevel.of(project.points, folder)
            points = read_points(point_path, project.points.crs or "", point_faults, scenes, level)
        else:
            points = read_foreign_points(_foreign(project, folder, file, "points"), point_faults, scenes)
    # names are compared only with lists without faults: otherwise one fault would cause others
    sizes = {name: (i.sensor.n_lines, i.sensor.n_samples) if i is not None else None for name, i in images.items()}
    known_images = sizes if len(sizes) == len(project.images) else None
    sound = points if not point_faults.codes & LOSES_IDS else None
    observations = None
    if project.observations.format == OWN:
        ids = sound.points.ids if sound is not None else None
        observations = read_observations(observation_path, known_images, ids, observation_faults, ties=ties)
        points = no_points(point_path, observations.ids) if ties and observations else points
    else:
        table = _foreign(project, folder, file, "observations")
        serials = {i.sensor.serial: name for name, i in images.items() if i is not None and i.sensor.serial}
        both = read_foreign_observations(table, known_images, sound, observation_faults, serials)
        observations, points = both or (None, points)
    # both tables may name the same file of another program: each of its faults is listed once
    problems = dict.fromkeys((*crs_problems, *point_faults.problems, *observation_faults.problems))
    return points, observations, tuple(problems)


def _scenes(images: Mapping[str, Image | None], tables: Sequence[Path]) -> list[Scene]:
    """Compute footprints; none if a file is missing, so that this is reported before kernels are compiled."""
    if None in images.values() or not all(path.exists() for path in tables):
        return []
    known = [(image.id, image.sensor) for image in images.values() if image is not None]
    return [Scene.from_footprint(name, sensor.footprint(), sensor.body) for name, sensor in known]


def _foreign(project: ProjectFile, folder: Path, file: str, name: str) -> Table:
    """Return the files of a table of another program. If a format has two files, each table names one of them."""
    entry = project.points if name == "points" else project.observations
    paths: tuple[Path, ...] = (folder / str(entry.file),)
    of_points = project.points.file
    if of_points and project.points.format == project.observations.format and of_points != project.observations.file:
        both = (folder / of_points, folder / project.observations.file)
        paths = both if len(format_named(entry.format, place=f"{name}.format").files) > 1 else paths
    if name == "observations" and project.points.format == entry.format:  # the entries of [points] apply to both tables
        given: dict[str, object] = {"crs": entry.crs or project.points.crs}
        if project.points.accept_unverified:
            given["accept_unverified"] = True
        entry = entry.model_copy(update=given)
    return Table(name, paths, entry, file)


def _entry_problems(project: ProjectFile, file: str) -> list[Finding]:
    """Return the faults of ``[points]`` and ``[observations]`` that the schema cannot detect."""
    faults = []
    for name, entry in (("points", project.points), ("observations", project.observations)):
        if entry.format == OWN:
            given = entry.model_fields_set - {"file", "format"} - (OWN_POINTS if name == "points" else set())
            faults += [finding("project.own_table", file=file, place=f"{name}.{key}") for key in sorted(given)]
    if not project.points.file and project.points.model_fields_set:
        expected = PointsEntry.model_fields["file"].description
        faults.append(finding("project.missing", file=file, place="points.file", expected=expected))
    elif project.points.file and project.points.crs is None and project.points.format == OWN:
        expected = 'an EPSG code in quotes, such as "EPSG:4979"'
        faults.append(finding("project.missing", file=file, place="points.crs", expected=expected))
    for name, crs in (("points", project.points.crs), ("observations", project.observations.crs)):
        try:
            if crs is not None:
                crs_kind(with_codes(crs))
        except InputError as error:
            faults += [replace(p, file=file, place=f"{name}.crs") for p in error.problems]
    return faults


def _notes(images: Sequence[Image], points: PointFile, remarks: Sequence[Finding]) -> tuple[Finding, ...]:
    """Collect the notes of the report: remarks, notes of the sensors, and the conversion of the coordinates."""
    sensor = [replace(note, place=f"image {image.id}") for image in images for note in image.sensor.notes]
    place = f"coordinates of {points.path.name}"
    if points.operation is None:
        return (*remarks, *sensor)
    return (*remarks, *sensor, finding("points.operation", place=place, operation=points.operation))
