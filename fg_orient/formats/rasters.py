"""What reads and writes rasters: rasterio, an extra."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fg_orient.model.errors import InputError


def rasterio_of(file: str | Path) -> Any:
    """Import rasterio.

    Parameters
    ----------
    file : path
        What needs it, for the message.

    Raises
    ------
    InputError
        It is not installed.
    """
    try:
        import rasterio
        import rasterio.windows
    except ImportError as error:
        raise InputError.of("ortho.no_rasterio", file=file) from error
    return rasterio
