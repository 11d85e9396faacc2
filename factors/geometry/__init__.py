"""Elementary maps with derivatives: rotations, orbits, ellipsoid, polynomials, light."""
