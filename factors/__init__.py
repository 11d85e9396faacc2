"""Observation equations and elementary maps: each gives its value together with its analytic Jacobian.

Lowest room of fg_orient: it imports only numpy and numba (``factors.graph`` also GTSAM). Each relation is in a file of
its own; ``factors._contract`` describes the calling convention.
"""

#: Version of both packages; ``fg_orient`` uses it to recognise its own ``factors`` package.
FG_ORIENT_FACTORS = "0.2.0"
