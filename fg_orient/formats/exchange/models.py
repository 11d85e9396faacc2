"""Frame models from one format into another: cameras, poses, points and image points of bundle programs.

Formats that hold all of these have ``read_model`` and ``write_model`` in the registry, beside their survey.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fg_orient.formats.exchange.convert import require_accepted
from fg_orient.formats.exchange.registry import Format, Settings
from fg_orient.formats.frame_model import FrameModel
from fg_orient.model.errors import Finding, InputError, finding


def convert_model(
    paths: Sequence[Path], reader: Format, out: Path, writer: Format, settings: Settings, *,
    accept_unverified: bool = False, overwrite: bool = False,
) -> tuple[FrameModel, tuple[Finding, ...]]:  # fmt: skip
    """Read a frame model and write it in another format.

    Parameters
    ----------
    paths : sequence of Path
        Files of the format that is read.
    reader, writer : Format
        The one has ``read_model``, the other ``write_model``.
    out : Path
        File or folder to write.
    settings : Settings
        ``image_sizes`` for formats that do not hold them.
    accept_unverified, overwrite : bool

    Returns
    -------
    model : FrameModel
    lost : tuple of Finding
        What the new format cannot hold.

    Raises
    ------
    InputError
        A file is unusable, the new format cannot hold a camera, or the output exists.
    """
    if reader.read_model is None or writer.write_model is None:
        raise InputError.of("interchange.no_writer", file=out, option="to", value=writer.name)
    require_accepted(paths, reader, accept_unverified)
    model = reader.read_model(tuple(paths), settings)
    settings.require_images([pose.name for pose in model.poses], paths[0])
    told = writer.write_model(out, model, overwrite)
    return model, tuple(finding("lost.model", file=out, value=text, format=writer.name) for text in told)
