"""The tests check the settings of the C allocator and of Python's collector during an adjustment."""

from __future__ import annotations

import gc
import resource
import sys

import pytest

from fg_orient.model.machine import calm_memory, keep_freed_memory

pytestmark = pytest.mark.behaviour

CHUNKS, CHUNK_BYTES = 4000, 4096


def page_faults_of_a_turn() -> int:
    """Return the page faults while some 16 MB of small blocks are taken and freed again."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    blocks = [bytearray(CHUNK_BYTES) for _ in range(CHUNKS)]
    del blocks
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


@pytest.mark.parametrize("on", [True, False])
def test_the_collector_rests_and_is_as_it_was(on: bool) -> None:
    assert gc.isenabled()
    try:
        if not on:
            gc.disable()
        with pytest.raises(ZeroDivisionError), calm_memory():
            assert not gc.isenabled()
            _ = 1 / 0
        assert gc.isenabled() is on
    finally:
        gc.enable()


@pytest.mark.skipif(
    not sys.platform.startswith("linux"),
    reason="only glibc, the C library of Linux, can be told",
)
def test_freed_blocks_are_not_given_back_to_the_system() -> None:
    if not keep_freed_memory():
        pytest.skip("the C library is not glibc")
    page_faults_of_a_turn()
    pages = CHUNKS * CHUNK_BYTES // resource.getpagesize()
    assert page_faults_of_a_turn() < pages / 4
