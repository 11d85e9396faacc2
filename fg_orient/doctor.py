"""Examines the installation: versions, traps of the environment, a self-test."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

from fg_orient.run.provenance import REQUIRED, versions


def examine() -> dict[str, Any]:
    """Examine the installation.

    Returns
    -------
    dict
        ``good``; ``versions`` by name (None = missing); ``checks``: list of name, good,
        detail; ``warnings``: list of sentences.
    """
    found = versions(REQUIRED)
    missing = [name for name, version in found.items() if version is None]
    checks = [{"name": "dependencies", "good": not missing, "detail": ", ".join(missing) or "all installed"}]
    for name, check in (("PROJ", _proj), ("numba cache", _numba_cache), ("self-test", _self_test)):
        try:
            good, detail = check()
        except Exception as error:  # a broken installation may fail in any way; the doctor must say how
            good, detail = False, f"{type(error).__name__}: {error}"
        checks.append({"name": name, "good": good, "detail": detail})
    return {
        "good": all(check["good"] for check in checks), "versions": found, "checks": checks, "warnings": _warnings(),
        "optional": versions(("rasterio", "pandas", "matplotlib", "dask")),
    }  # fmt: skip


def _warnings() -> list[str]:
    """Traps that stop nothing by themselves."""
    return [
        f"{name} is set to {os.environ[name]}: PROJ may read the data of another installation; unset it"
        for name in ("PROJ_LIB", "PROJ_DATA")
        if os.environ.get(name)
    ]


def _proj() -> tuple[bool, str]:
    """Transform one point there and back; says where PROJ's data lie."""
    import numpy as np

    from fg_orient.geodesy import data_folder, ecef_to_geodetic, geodetic_to_ecef

    there = geodetic_to_ecef([31.85], [41.3], [100.0])
    back = np.array(ecef_to_geodetic(there))[:, 0]
    good = bool(np.abs(back - [31.85, 41.3, 100.0]).max() < 1e-6)
    return good, f"data in {data_folder()}"


def _numba_cache() -> tuple[bool, str]:
    """Ask numba where it keeps compiled kernels; without a writable place every start compiles anew."""
    from factors import ellipsoid

    kernel: Any = ellipsoid.geodetic_array
    folder = Path(kernel.stats.cache_path)
    there = next(p for p in (folder, *folder.parents) if p.exists())
    if os.access(there, os.W_OK):
        return True, f"{folder} is writable"
    return False, f"{folder} is not writable: every start compiles anew; set NUMBA_CACHE_DIR to a folder of yours"


def _self_test() -> tuple[bool, str]:
    from fg_orient.selftest import self_test

    start = time.perf_counter()
    good, detail = self_test()
    return good, f"{detail}, {time.perf_counter() - start:.1f} s"
