"""Observation equations and elementary maps: value and analytic Jacobian together.

The ground floor of fg_orient: numpy and numba only (``factors.graph`` adds GTSAM). One
relation per file; the calling convention is in ``factors._contract``.
"""

#: Marker by which ``fg_orient`` recognises its own ``factors`` package: the version that both have.
FG_ORIENT_FACTORS = "0.2.0"
