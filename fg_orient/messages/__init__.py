"""The message catalogue: every error and warning a user can meet, in one place.

Each entry maps a stable code to ``(message, remedy)``. Both are format strings; the
fields are the keyword arguments given to :func:`fg_orient.errors.problem`. The code's
first part is the domain (``xml``, ``dimap``, ``points``, ...). Tests hold the catalogue and
the sources against each other: no code is unknown or unused, no field of a message is missing.
"""

from __future__ import annotations

from typing import Final

from fg_orient.messages.closerange import CLOSERANGE
from fg_orient.messages.dense import CLASSICAL, COMPARE, LINEAR, PUBLISHED, REPRODUCE
from fg_orient.messages.earth import EARTH
from fg_orient.messages.files import DEM, DIMAP, GEODESY, OBSERVATIONS, POINTS, PROJECT, SENSOR, TABLE, XML
from fg_orient.messages.frame import FRAME
from fg_orient.messages.installation import INSTALLATION
from fg_orient.messages.interchange import INTERCHANGE
from fg_orient.messages.parallel import PARALLEL
from fg_orient.messages.rectify import RECTIFY
from fg_orient.messages.rfm import RFM
from fg_orient.messages.rpc import RPC
from fg_orient.messages.statistics import STATISTICS
from fg_orient.messages.ties import TIES
from fg_orient.messages.work import ADJUST, CLI, OPTIONS, OUTPUT, PARAMETERS, REMARKS, REPLAY, REPORT

CATALOGUE: Final[dict[str, tuple[str, str]]] = {
    **XML,
    **DIMAP,
    **SENSOR,
    **DEM,
    **GEODESY,
    **TABLE,
    **POINTS,
    **OBSERVATIONS,
    **PROJECT,
    **PARAMETERS,
    **OPTIONS,
    **ADJUST,
    **REMARKS,
    **OUTPUT,
    **REPLAY,
    **CLI,
    **REPORT,
    **LINEAR,
    **PUBLISHED,
    **REPRODUCE,
    **CLASSICAL,
    **COMPARE,
    **RPC,
    **RFM,
    **RECTIFY,
    **FRAME,
    **PARALLEL,
    **CLOSERANGE,
    **STATISTICS,
    **EARTH,
    **INSTALLATION,
    **INTERCHANGE,
    **TIES,
}
