"""Observations other than image points: control, navigation, distances, planes, surfaces."""
