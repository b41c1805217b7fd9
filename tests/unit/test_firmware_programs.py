"""Runs the firmware's own tests on this computer, and builds it for the boards' processors."""

import shutil
import struct
import subprocess

import pytest
from testkit.paths import FIRMWARE

pytestmark = pytest.mark.slow

RAM_END = 0x1000_8000
FLASH_SIZE = 512 * 1024
PROTECTION = 0x2FC  # address of a word that may lock the chip

ARM_TOOLS = ("make", "gcc", "arm-none-eabi-gcc", "qemu-system-arm")
needs_arm = pytest.mark.skipif(
    None in map(shutil.which, ARM_TOOLS),
    reason=f"needs {', '.join(ARM_TOOLS)}; Debian has gcc-arm-none-eabi, libnewlib-arm-none-eabi "
    "and qemu-system-arm",
)


def make(target, build):
    command = ["make", "--no-print-directory", f"BUILD={build}", target]
    return subprocess.run(command, cwd=FIRMWARE, capture_output=True, text=True)


@pytest.mark.skipif(
    shutil.which("make") is None or shutil.which("g++") is None, reason="no make or g++ found"
)
@pytest.mark.parametrize(
    ("target", "passed", "count"),
    [
        ("test", "87 checks, 0 failures", 1),
        pytest.param("sanitize", "87 checks, 0 failures", 1, marks=pytest.mark.long),
        # of two boards, with coils and with electrodes; regression: after a reset by the chip's own
        # watchdog the driver took up the next frame
        pytest.param("sketch", "field_driver: 0 failures", 2 * 2, marks=pytest.mark.long),
    ],
)
def test_the_firmwares_own_tests_pass(tmp_path, target, passed, count):
    done = make(target, tmp_path)
    if target != "test" and "cannot find -l" in done.stderr:
        pytest.skip("the compiler has no sanitizer libraries")
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count(passed) == count
    assert target == "sketch" or done.stdout.endswith("\npassed\n")


@needs_arm
@pytest.mark.system
def test_the_program_for_the_mbed_is_one_that_its_boot_rom_starts(tmp_path):
    done = make("lpc1768", tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    programs = [(tmp_path / f"m3pi-{index}.bin").read_bytes() for index in range(3)]
    assert len(set(programs)) == 3  # each has its own place in the frame
    for program in programs:
        assert len(program) < FLASH_SIZE
        stack, start, *rest = struct.unpack_from("<8I", program)
        assert stack == RAM_END
        assert start % 2 == 1  # Thumb
        assert PROTECTION < start < len(program)
        assert (stack + start + sum(rest)) % 2**32 == 0
        assert struct.unpack_from("<I", program, PROTECTION) == (0xFFFFFFFF,)


@needs_arm
@pytest.mark.system
def test_emulated_cortex_processors_do_what_this_computer_does(tmp_path):
    done = make("qemu", tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "start-up: passed\n" in done.stdout + done.stderr
    same = "5 test programs passed, and the core did the same as here with 10000 packets\n"
    assert done.stdout.endswith(f"cortex-m0plus: {same}cortex-m3: {same}")
    events = {
        event
        for line in (tmp_path / "trace-cortex-m3.txt").read_text().splitlines()
        for event in line.partition("|")[0].split()[2:]
    }
    assert events == {"1", "2", "3", "4"}  # accepted, stale, rejected, foreign
