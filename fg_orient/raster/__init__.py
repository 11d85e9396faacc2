"""Rasters: orthorectification and resampling of large images in windows."""
