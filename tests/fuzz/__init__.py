"""Fuzzing of the readers: whatever the bytes, a reader returns a value or raises an FgOrientError.

``python -m tests.fuzz --minutes 60 --reader geojson --seed 1`` changes the files of a reader at random. What is found
is written to a folder; a case that was corrected is kept in ``found/`` and read by ``test_found.py``.
"""
