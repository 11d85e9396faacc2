"""Recognise the version of a DIMAP metadata file and call its reader.

Supported files are DIMAP 1.1 of SPOT 1 to 5 at level 1A, DIMAP 2.x sensor products of
Pléiades 1A/1B and SPOT 6/7, and the PHR_DIMAP of CNES. For other known files, the message
names the kind of the file and the product to use instead.
"""

from __future__ import annotations

import os
from pathlib import Path

from fg_orient.formats import dimap1, dimap2
from fg_orient.formats.registry import Format, xml_root
from fg_orient.formats.rpc.dimap import is_rpc
from fg_orient.formats.xml import read_xml
from fg_orient.sensors.metadata import PushbroomMetadata
from fg_orient.sensors.pushbroom import PushbroomSensor

_ROOTS = {
    "isd": "a DigitalGlobe ISD file",
    "VRTDataset": "a GDAL virtual raster",
    "PAMDataset": "a GDAL .aux.xml file",
}
_PROFILE_PREFIXES = {
    "PNEO": "Pléiades Neo", "PER1": "PeruSat-1", "VNREDSAT": "VNREDSat-1", "S6_": "SPOT 6", "S7_": "SPOT 7",
    "PHR": "Pléiades", "SPOT": "SPOT 1 to 5", "DEIMOS": "Deimos", "FORMOSAT": "Formosat",
}  # fmt: skip


def read_dimap(path: str | os.PathLike[str]) -> PushbroomMetadata:
    """Read the rigorous model from a DIMAP metadata file.

    Parameters
    ----------
    path : path
        ``METADATA.DIM`` of a SPOT 1-5 level 1A scene, or ``DIM_*.XML`` of a Pléiades 1A/1B or
        SPOT 6/7 sensor product, or ``PHRDIMAP_*.XML`` of CNES.

    Returns
    -------
    PushbroomMetadata
        Pixels are counted from 0, times are seconds of the day ``epoch``. Units are ECEF metres and radians.

    Raises
    ------
    InputError
        The file cannot be used; the message is one line with file, place, value and remedy.
    OutOfTimeRange
        More than 0.2 s of the image has no angular speeds (SPOT 1 to 4).
    """
    root = read_xml(path)
    if root.tag == dimap2.PHR_ROOT:
        return dimap2.read_dimap_phr(root)
    if root.tag != "Dimap_Document":
        raise root.fault("dimap.other_format", _ROOTS.get(root.tag, f"root element {root.tag}"))
    first = root.maybe("Metadata_Id")
    head = first or root.one("Metadata_Identification")
    form, profile = head.one("METADATA_FORMAT"), head.one("METADATA_PROFILE").text()
    version, sub = form.element.get("version", ""), head.maybe("METADATA_SUBPROFILE")
    names = [f" ({name})" for prefix, name in _PROFILE_PREFIXES.items() if profile.upper().startswith(prefix)]
    seen = f"{form.text()} {version or 'without version'}, profile {profile}{''.join(names[:1])}"
    if not first and ((sub and sub.text() == "RPC") or root.maybe("Rational_Function_Model")):
        raise head.fault("dimap.rpc_file", f"RPC file, {seen}")
    if form.text() != "DIMAP" or not (version == "1.1" if first else version.startswith("2.")):
        raise form.fault("dimap.other_version", seen)
    if profile not in (dimap1.PROFILES if first else dimap2.PROFILES):
        known = profile.startswith("SPOT" if first else ("PHR_", "S6_", "S7_"))
        raise head.fault("dimap.other_level" if known else "dimap.other_mission", seen)
    if not first:
        return dimap2.read_dimap2(root)
    level = root.maybe("Data_Processing/PROCESSING_LEVEL")
    if level is not None and level.text() != "1A":
        raise level.fault("dimap.other_level", f"{seen}, level {level.text()}")
    mission = root.one("Dataset_Sources/Source_Information/Scene_Source/MISSION")
    if mission.text() != "SPOT":
        raise mission.fault("dimap.other_mission", f"{seen}, mission {mission.text()}")
    return dimap1.read_dimap1(root)


def _is_rigorous(path: Path, head: str) -> bool:
    """Return whether a file contains the rigorous model.

    A PHR_DIMAP may contain it in addition to its RPC.
    """
    root = xml_root(head)
    if root == dimap2.PHR_ROOT:
        return read_xml(path).maybe(dimap2.PHR_MODEL) is not None
    return root == "Dimap_Document" and not is_rpc(head)


def read_sensor(path: Path, *, extrapolate_attitude_s: float = 0.0) -> PushbroomSensor:
    """Read a DIMAP file and return its sensor; see :func:`read_dimap`."""
    return PushbroomSensor(read_dimap(path), extrapolate_attitude_s=extrapolate_attitude_s)


FORMAT = Format(
    name="dimap-metadata", title="DIMAP metadata", sniff=_is_rigorous, read_image=read_sensor,
    extrapolates=True, beside_rpc=True,
)  # fmt: skip
