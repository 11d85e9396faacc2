"""Tie points from pixels: search along epipolar curves of the sensor models, least-squares matching, tables, report."""
