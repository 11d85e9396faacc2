"""Observation equations and elementary maps: value and analytic Jacobian together.

Lowest room of fg_orient: it imports numpy and numba only (``factors.graph`` also GTSAM). Each relation is in one file;
the calling convention is in ``factors._contract``.
"""

#: Version of both packages, by which ``fg_orient`` recognises its own ``factors`` package.
FG_ORIENT_FACTORS = "0.2.0"
