"""Formats of other programs for points and image points.

Each format has one module (docs/formats).
"""
