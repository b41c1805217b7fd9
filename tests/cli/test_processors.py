"""Tests that a trial has the same bits on every x86-64 processor.

The same trials run in processes of their own, in which the libraries take the processor for an
older model. The libraries then choose other code, as they do on such a computer.
"""

import sys

import pytest
from testkit.cli import process
from testkit.paths import ROOT

from tetractl.log.provenance import machine
from tetractl.log.read.reader import content_digest

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(
        sys.platform != "linux" or machine() != "x86_64", reason="knows names of x86-64 only"
    ),
]

SHORT = ("--set", "controller.time_limit=3", "--trials", "1", "--quiet")
TRIALS = {
    "bench": ("three_m3pi_bench.yaml", *SHORT),
    "paper": ("three_m3pi_paper_bench.yaml", "--trials", "1", "--quiet"),
    "cells": ("tetrahymena_disturbed.yaml", *SHORT),
    "lab": ("three_m3pi_lab.yaml", *SHORT, "--plant", "emulated"),
}
NUMPY_V4 = "X86_V4 AVX512_ICL AVX512_SPR"
"""What NumPy calls the instructions of a processor with AVX-512, all above X86_V3."""
OLDER = {
    "without AVX-512": {"NPY_DISABLE_CPU_FEATURES": NUMPY_V4, "OPENBLAS_CORETYPE": "Haswell"},
    "without AVX and FMA": {
        "NPY_DISABLE_CPU_FEATURES": f"X86_V3 {NUMPY_V4}",
        "OPENBLAS_CORETYPE": "Prescott",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-AVX2,-AVX,-AVX512F",
    },
}
"""Settings of NumPy, of the BLAS in it and SciPy, and of the C library's `sin` and `exp`."""
TARGETS = {
    "compiled for a processor of 2008": {"NUMBA_CPU_NAME": "nehalem"},
    "compiled for a processor of 2013": {"NUMBA_CPU_NAME": "haswell"},
}


def digests(folder, settings):
    """Return the content digest of each of the TRIALS, run in processes with these settings."""
    found = {}
    quiet = {"PYTHONWARNINGS": "ignore"}  # NumPy warns of features that a processor lacks anyway
    for name, (spec, *words) in TRIALS.items():
        out = folder / name
        path = ROOT / "experiments" / spec
        process(folder, "run", path, "--out", out, *words, env=quiet | settings).ok()
        (log,) = out.glob("*.mcap")
        found[name] = content_digest(log)
    return found


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    return digests(tmp_path_factory.mktemp("here"), {})


@pytest.mark.parametrize("settings", OLDER.values(), ids=OLDER)
def test_libraries_that_choose_other_code_change_no_bit_of_a_trial(tmp_path, here, settings):
    assert digests(tmp_path, settings) == here


@pytest.mark.release  # compiles everything again
@pytest.mark.parametrize("settings", TARGETS.values(), ids=TARGETS)
def test_code_for_another_processor_changes_no_bit_of_a_trial(tmp_path, here, settings):
    assert digests(tmp_path, settings) == here
