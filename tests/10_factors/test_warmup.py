"""The warm-up compiles what an adjustment calls: nothing is left to be compiled inside the clocks of a run."""

from __future__ import annotations

import json
import subprocess
import sys

#: A process of its own: in this one other tests have compiled what the warm-up may lack.
PROGRAM = """
import json, sys
from factors.warmup import compile_kernels

def signatures():
    return {
        (f.py_func.__module__ + "." + f.py_func.__name__, str(s))
        for name, module in list(sys.modules.items()) if name.startswith("factors")
        for f in vars(module).values() if hasattr(f, "nopython_signatures") for s in f.signatures
    }

import fg_orient as fg
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block
from tests.support.rpc_block import rpc_twin

compile_kernels()
known = signatures()
left = {}
for kind, block in (("pushbroom", zonguldak_block(ZonguldakOptions())[0]), ("rpc", rpc_twin("affine").block)):
    for image in block.images:
        image.sensor.footprint()
    for backend in ("graph", "schur", "dense"):
        solution = fg.adjust(block, backend=backend)
    solution.locate(block.images[0].id, 10.0, 10.0, height_m=100.0)
    solution.reliability()
    left[kind] = sorted(signatures() - known)
    known |= signatures()
json.dump([len(known), left], sys.stdout)
"""


def test_first_use_compiles_nothing() -> None:
    ended = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    count, left = json.loads(ended.stdout)
    assert count > 40
    assert left == {"pushbroom": [], "rpc": []}
