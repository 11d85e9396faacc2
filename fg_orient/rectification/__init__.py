"""Rectification: transformations between image and map, map accuracy, areas, scanner geometry.

Source of the plane methods: C. İpbüker (1994), MSc thesis, Istanbul Technical University: geometric accuracy of images
at map scale from satellite data. Cited as İpbüker 1994.
"""
