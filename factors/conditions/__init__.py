"""Observations that are no image points: control, navigation, distances, planes, surfaces."""
