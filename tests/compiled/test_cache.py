"""Machine code is kept where that is possible, and what is damaged is made anew."""

import os
import shutil
import subprocess
import sys

import pytest

from conftest import ROOT

_USE = """
import numpy as np
from vehicle_detection.compiled.cache import compiled
from module import double
print(double(21), len(double.stats.cache_hits), len(double.stats.cache_misses))
"""


@pytest.fixture
def module(tmp_path):
    (tmp_path / "module.py").write_text(
        "from vehicle_detection.compiled.cache import compiled\n\n"
        "@compiled()\ndef double(x):\n    return 2 * x\n"
    )
    return tmp_path


def run(module, **environment):
    result = subprocess.run(
        [sys.executable, "-c", _USE], cwd=module, capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": f"{ROOT}:{module}"} | environment,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    return result.stdout.split()


def test_the_second_run_compiles_nothing(module):
    assert run(module) == ["42", "0", "1"]
    assert run(module) == ["42", "1", "0"]


@pytest.mark.parametrize("kind", ["*.nbi", "*.nbc"])
@pytest.mark.parametrize("damage", ["empty", "half", "zeros", "one bit"])
def test_what_is_damaged_is_made_anew(module, kind, damage):
    run(module)
    for path in (module / "__pycache__").glob(kind):
        content = bytearray(path.read_bytes())
        middle = len(content) // 2
        if damage == "empty":
            content = b""
        elif damage == "half":
            content = content[:middle]
        elif damage == "zeros":
            content[middle:] = bytes(len(content) - middle)
        else:
            content[middle] ^= 1
        path.write_bytes(content)
    assert run(module)[0] == "42"
    assert run(module) == ["42", "1", "0"]


def test_without_any_folder_to_write_to_it_runs(module, tmp_path):
    """A file stands where the folders would be made, for root may write anywhere."""
    shutil.rmtree(module / "__pycache__", ignore_errors=True)
    (module / "__pycache__").touch()
    (tmp_path / "file").touch()
    nowhere = str(tmp_path / "file")
    assert run(module, HOME=nowhere, XDG_CACHE_HOME=nowhere, NUMBA_CACHE_DIR="")[0] == "42"
