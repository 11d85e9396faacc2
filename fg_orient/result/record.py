"""Result of an adjustment as one record: the JSON record, tables, iterations and arrays of a result folder.

A run makes the result from a solution (``fg_orient.result.summary.result_of``), writes it
to a folder and makes the page from it. :func:`read_result` reads the folder again. A page
that is made from the folder is equal to the page that the run made.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index
from fg_orient.formats.atomic import RESULT
from fg_orient.formats.load import load_bytes, load_npz, parse_json
from fg_orient.formats.table_write import WHOLE, table_file
from fg_orient.model.errors import Finding, InputError, decisive, finding, findings_of
from fg_orient.model.names import TABLE_FORM, Status
from fg_orient.result.joint import JointCofactors
from fg_orient.result.manifest import MANIFEST_FILE, checked_record
from fg_orient.result.plain import Table, dumps, plain, read_table, table_of_rows

if TYPE_CHECKING:
    import pandas

#: A folder that contains this file is a result folder.
RESULT_FILE: Final = RESULT.mark
ITERATIONS_FILE: Final = "iterations.jsonl"
ARRAYS_FILE: Final = "arrays.npz"
COVARIANCE_FILE: Final = "covariance.npz"
#: Table of the start values of the points. If the block was not adjusted, it is the only table.
START_POINTS: Final = "start_points"
_ENU: Final = ("east_m", "north_m", "up_m")
#: Names of the tables of a result, and the columns that each table must have.
TABLES: Final = {
    "points": ("id", "role", "lon_deg", "lat_deg", "x_m", "y_m", "z_m", "sigma_scale",
               *(f"sigma_{axis}" for axis in _ENU), *(f"difference_{axis}" for axis in _ENU)),
    "residuals": ("image", "id", "line", "sample", "v_line_px", "v_sample_px", "sigma_line_px", "sigma_sample_px"),
    "eop": ("image", "parameter", "component", "degree", "unit", "value_per_tau", "sigma", "prior_sigma"),
    START_POINTS: ("id", "role", "n_rays", "lon_deg", "lat_deg"),
}  # fmt: skip
#: The names of accuracy figures in the record begin with one of these.
_ACCURACY: Final = ("n", "rmse_", "mean_", "sd_", "max_", "ce9", "le9")


@dataclass(frozen=True, repr=False)
class Result:
    """Result of an adjustment: the content of a result folder.

    Parameters
    ----------
    record : dict
        Content of ``result.json`` (docs/results.md).
    tables : dict
        Tables by the names of their files: ``points``, ``residuals``, ``eop``. After a search
        for gross errors also ``outliers``, with jitter ``jitter``. If the block was not adjusted, only
        ``start_points``.
    iterations : tuple of dict
        One record per iteration.
    arrays : dict
        Content of ``arrays.npz``.
    files : dict
        Further files (corrected RPC) by their names in the folder.
    joint : JointCofactors or None
        Joint cofactors of images and points: the content of ``covariance.npz``.
    """

    record: dict[str, Any]
    tables: dict[str, Table]
    iterations: tuple[dict[str, Any], ...] = ()
    arrays: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict)
    files: Mapping[str, bytes] = field(default_factory=dict)
    joint: JointCofactors | None = None

    @property
    def points(self) -> Table:
        """Return the table of ground points.

        If the block was not adjusted, it contains their start values.
        """
        return self.tables["points" if self.adjusted else START_POINTS]

    @property
    def residuals(self) -> Table:
        """Return the table of image points and their residuals."""
        return self.tables["residuals"]

    @property
    def eop(self) -> Table:
        """Return the table of the orientation unknowns of the images."""
        return self.tables["eop"]

    @property
    def accuracy(self) -> Table:
        """Return the table of the accuracy assessment with one figure in each row."""
        rows = [(role, name, np.nan if value is None else value)
                for role, figures in self.record["accuracy"].items()
                for name, value in figures.items() if name.startswith(_ACCURACY)]  # fmt: skip
        return table_of_rows(("role", "quantity", "value"), rows)

    def file(self, table: str) -> str:
        """Return the file name of a table in the result folder.

        The option ``tables`` determines its format.
        """
        options = self.record.get("provenance", {}).get("options", {})
        return f"{table}.{options.get('tables', TABLE_FORM)}"

    @property
    def adjusted(self) -> bool:
        """Return whether the block was adjusted.

        If not, the result has no adjusted coordinates and no orientation.
        """
        return self.record.get("status") != Status.RANK_DEFICIENT

    @property
    def images(self) -> list[str]:
        """Return the ids of the images."""
        return [str(image["id"]) for image in self.record["images"]]

    @cached_property
    def rows(self) -> dict[str, Index]:
        """Return the rows of the table ``residuals`` for each image, in the order of the record."""
        image = self.residuals.codes("image", self.images)
        return {name: np.flatnonzero(image == k) for k, name in enumerate(self.images)}

    @cached_property
    def normalised(self) -> tuple[Array, bool]:
        """Return normalised residuals (n, 2) of line and sample.

        With redundancy numbers r, a residual is divided by its own standard deviation:
        ``w = v / (sigma sqrt(r))``. These values have a standard normal distribution if
        the model is correct. Without redundancy numbers, a residual is divided by the
        standard deviation of its observation. These values scatter less. A value is nan
        if no other observation checks this one.
        """
        w = self.residuals.numbers("w_line", "w_sample")
        if np.isfinite(w).any():
            return w, True
        v, sigma = (self.residuals.numbers(f"{name}_line_px", f"{name}_sample_px") for name in ("v", "sigma"))
        return v / sigma, False

    @cached_property
    def cofactors(self) -> dict[str, Array]:
        """Return the cofactor matrix (k, k) of each image's unknowns, in physical units and prior scale.

        The result is empty if the folder has no ``arrays.npz``.
        """
        return self._of_images("image_cofactors")

    def _of_images(self, name: str) -> dict[str, Array]:
        """Return, for each image, the square matrix of its unknowns."""
        if not self.arrays:
            return {}
        counts, stacked = self.arrays["n_parameters"].tolist(), np.asarray(self.arrays[name], float)
        return {image: q[:n, :n] for image, n, q in zip(self.images, counts, stacked, strict=True)}

    def residual_summary(self) -> list[dict[str, Any]]:
        """Return for each image the root mean square and the largest residual, px, and the largest v/sigma."""
        table = self.residuals
        v, sigma = table.numbers("v_line_px", "v_sample_px"), table.numbers("sigma_line_px", "sigma_sample_px")
        out = []
        for name in dict.fromkeys(table.words["image"]):
            rows = self.rows[name]
            part, ratio = v[rows], np.abs(v[rows] / sigma[rows]).max(axis=1)
            worst = int(np.argmax(ratio))
            out.append({
                "image": name, "n": len(rows), "rms_line_px": float(np.sqrt(np.mean(part[:, 0] ** 2))),
                "rms_sample_px": float(np.sqrt(np.mean(part[:, 1] ** 2))), "max_px": float(np.abs(part).max()),
                "max_ratio": float(ratio[worst]), "worst": table.words["id"][int(rows[worst])],
            })  # fmt: skip
        return out

    def write(self, folder: Path) -> None:
        """Write all files except the page and the manifest to an existing folder."""
        tables = {**self.tables, "accuracy": self.accuracy} if self.adjusted else self.tables
        for name, table in tables.items():
            table.write(folder / self.file(name))
        if self.adjusted:
            lines = (dumps(iteration) + "\n" for iteration in self.iterations)
            (folder / ITERATIONS_FILE).write_text("".join(lines), encoding="utf-8")
            np.savez(folder / ARRAYS_FILE, allow_pickle=False, **self.arrays)
            if self.joint is not None:
                np.savez(folder / COVARIANCE_FILE, allow_pickle=False, **self.joint.arrays())
        for name, data in self.files.items():
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_bytes(data)
        write_record(folder, self.record)

    def to_frame(self, table: str = "points") -> pandas.DataFrame:
        """Return a table as ``pandas.DataFrame`` (extra "tables").

        Parameters
        ----------
        table : str
            ``points``, ``residuals``, ``unknowns`` (``eop``), ``accuracy``, ``outliers``,
            ``jitter``, ``iterations``, or ``covariances``. The last one contains the covariance matrix of
            the unknowns of each image; its index is image and parameter.

        Raises
        ------
        InputError
            The result has no such table.
        """
        import pandas

        if table == "iterations":
            return pandas.DataFrame(list(self.iterations))
        if table == "covariances":
            words = self.eop.words
            names = {image: [p for i, p in zip(words["image"], words["parameter"], strict=True) if i == image]
                     for image in self.images}  # fmt: skip
            matrices = self._of_images("image_covariance")
            frames = {image: pandas.DataFrame(q, names[image], names[image]) for image, q in matrices.items()}
            return pandas.concat(frames, names=["image", "parameter"])
        found = self.accuracy if table == "accuracy" else self.tables.get({"unknowns": "eop"}.get(table, table))
        if found is None:
            known = ", ".join((*self.tables, "unknowns", "accuracy", "iterations", "covariances"))
            raise InputError.of("options.value", place="table", value=table, expected=known)
        whole = {name: int for name in WHOLE & found.figures.keys() if np.isfinite(found.figures[name]).all()}
        return pandas.DataFrame(found.values).astype(whole)

    def to_geo(self) -> dict[str, Any]:
        """Return the points as a GeoJSON FeatureCollection (RFC 7946): longitude and latitude (degrees, WGS 84).

        The properties of a point are all columns of the table of points. Points without
        geographic coordinates are left out.
        """
        require_earth(self, self.record["out"])
        table = self.points
        rows = np.flatnonzero(np.isfinite(table.numbers("lon_deg", "lat_deg")).all(axis=1)).tolist()
        features = [
            {"type": "Feature", "geometry": {"type": "Point", "coordinates": place},
             "properties": {name: plain(values[k]) for name, values in table.values.items()}}
            for k, place in zip(rows, table.numbers("lon_deg", "lat_deg")[rows].tolist(), strict=True)
        ]  # fmt: skip
        return {"type": "FeatureCollection", "features": features}

    def __repr__(self) -> str:
        return one_line("Result", overview(self.record))

    def _repr_html_(self) -> str:
        return html_table("Result", overview(self.record))


def require_earth(result: Result, file: object, *, option: str = "") -> None:
    """Refuse a result on another body than the Earth; callers need WGS 84 coordinates."""
    body = result.record.get("body")
    if body is not None:
        raise InputError.of("body.earth", file=file, option=option, value=body["name"])


def overview(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return the most important figures of a record."""
    check = (record.get("accuracy") or {}).get("check") or {}
    rmse = [check.get(f"rmse_{axis}") for axis in _ENU]
    return {
        "name": record.get("name"), "status": record.get("status"), "sigma0": record.get("sigma0"),
        "redundancy": record.get("redundancy"), "image points": record.get("n_image_points"),
        "iterations": record.get("iterations"), "backend": record.get("backend"),
        "check points, RMSE (m)": None if None in rmse else " ".join(f"{value:.3g}" for value in rmse),
    }  # fmt: skip


def _texts_of(figures: Mapping[str, Any]) -> dict[str, str]:
    given = {key: value for key, value in figures.items() if value not in (None, "")}
    return {key: f"{value:.4g}" if isinstance(value, float) else str(value) for key, value in given.items()}


def one_line(kind: str, figures: Mapping[str, Any]) -> str:
    """Return a short text for an object, below 300 characters."""
    return f"<{kind}: {', '.join(f'{key} {text[:60]}' for key, text in _texts_of(figures).items())}"[:290] + ">"


def html_table(kind: str, figures: Mapping[str, Any]) -> str:
    """Return an HTML table of two columns for notebooks."""
    rows = (f"<tr><th>{escape(key)}</th><td>{escape(text)}</td></tr>" for key, text in _texts_of(figures).items())
    return f"<table><caption>{escape(kind)}</caption>{''.join(rows)}</table>"


# --- reading ---------------------------------------------------------------------------------------


def write_record(folder: Path, record: Mapping[str, Any]) -> None:
    """Write ``result.json``."""
    (folder / RESULT_FILE).write_text(dumps(record, indent=1) + "\n", encoding="utf-8")


def doubts_about(record: Mapping[str, Any], folder: str | Path) -> list[Finding]:
    """Return the doubt on everything that is computed from a result, if the result is not trustworthy."""
    if record.get("status", "good") in (Status.CONVERGED, "good"):  # fits of earlier versions have no status
        return []
    reason = record.get("reason") or next(map(str, decisive(findings_of(record))), "")
    return [
        finding(
            "result.doubt (doubt): this result is not trustworthy + : {reason} -> read its findings before you use its "
            "orientation or its points",
            file=folder, reason=reason.partition(";")[0] or None,
        )
    ]  # fmt: skip


def read_record(folder: Path) -> dict[str, Any]:
    """Read ``result.json`` of a result folder, and check that all files belong to its run.

    Raises
    ------
    InputError
        The file is missing or damaged. Or the folder is incomplete or was changed
        (``fg_orient.result.manifest``).
    """
    if not (folder / RESULT_FILE).is_file() and not (folder / MANIFEST_FILE).is_file():
        raise InputError.of("report.no_result", file=folder, place="DIR", value=f"no {RESULT_FILE}")
    return checked_record(folder, RESULT_FILE, RESULT, "report.damaged")


def read_result(folder: str | Path) -> Result:
    """Read a result folder that ``fg-orient adjust`` or ``Solution.save`` wrote.

    Raises
    ------
    InputError
        A file is missing or damaged, or the block was not adjusted.
    """
    result = read_any_result(Path(folder))
    if not result.adjusted:
        value = result.record["status"]
        raise InputError.of("report.nothing_adjusted", file=folder, place=RESULT_FILE, value=value)
    return result


@contextmanager
def _damaged(file: Callable[[], Path]) -> Iterator[None]:
    """Convert errors that wrong content of a file causes to InputErrors that name the file."""
    try:
        yield
    except (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError, OverflowError) as error:
        raise InputError.of("report.damaged", file=file(), value=error or type(error).__name__) from None


def read_any_result(folder: Path) -> Result:
    """Read a result folder, even if the block was not adjusted because unknowns were not determined.

    Raises
    ------
    InputError
        A file is missing or damaged.
    """
    result = Result(read_record(folder), {})
    names = [name for name in TABLES if (name == START_POINTS) != result.adjusted]
    names += [name for name in ("outliers", "jitter") if table_file(folder, name).is_file()]
    file = ""
    with _damaged(lambda: folder / file):
        tables = {name: read_table(table_file(folder, name), *TABLES.get(name, ())) for name in names}
        if not result.adjusted:
            return Result(result.record, tables)
        lines = load_bytes(folder / (file := ITERATIONS_FILE), "json_bytes", "report.damaged").splitlines()
        iterations = tuple(parse_json(line, folder / file, "report.damaged") for line in lines)
        arrays = _read_arrays(folder / (file := ARRAYS_FILE), len(result.images))
        paths = sorted(folder.glob("rpc/*_RPC.TXT"))
        files = {path.relative_to(folder).as_posix(): load_bytes(path, "rpc_bytes") for path in paths}
        joint = None
        if (folder / (file := COVARIANCE_FILE)).is_file():
            joint = JointCofactors.of_arrays(load_npz(folder / file, "report.damaged"))
        return Result(result.record, tables, iterations, arrays, files, joint)


def _read_arrays(path: Path, n_images: int) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of a result; the result is empty if the file does not exist."""
    if not path.is_file():
        return {}
    arrays = load_npz(path, "report.damaged")
    if len(arrays["n_parameters"]) != n_images or len(arrays["image_cofactors"]) != n_images:
        raise ValueError(f"not of {n_images} images")
    return arrays
