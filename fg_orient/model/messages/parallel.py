"""Messages about blocks in parts and studies on many workers."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
parallel.number: this number is not possible
    -> give a whole number from {low} to {high}
parallel.kind: this kind of value is not possible
    -> give {expected}
parallel.parts: the {points} ground points cannot be divided into so many parts
    -> give a number from 1 to {points}, or leave it out
parallel.no_parts: a work folder is for a block in parts, and nothing divides this one
    -> give parts, workers or a scheduler, or leave the work folder out
parallel.backend: parts are adjusted by the Schur backend, not by {value}
    -> leave the backend out, or adjust without parts and workers
parallel.dask: several workers need dask, which is missing
    -> pip install "fg-orient[cluster]", or one worker
parallel.unreachable: no scheduler answers at this address
    -> start dask scheduler and workers, see docs/parallel.md
parallel.folder: a file of the work folder cannot be read where the work is done
    -> give a folder that all workers see under the same name (<work_dir>)
parallel.version: the worker has another version of fg_orient than {written}
    -> install the same version everywhere: results must not depend on the worker
parallel.killed: the same work ended several workers
    -> look at the memory of the workers: take fewer of them, or more parts (a checkpoint needs the same parts)
parallel.lost: the cluster has gone or no longer answers
    -> look at its scheduler; adjust goes on with <resume>
parallel.result: this file of an earlier run cannot be read
    -> remove it; its case is then computed again
""")
