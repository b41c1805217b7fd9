"""Tests of `tetractl lab bundle`, which packs a report in one archive."""

from testkit.cli import tetractl
from testkit.paths import ROOT

LOG = ROOT / "tests/golden/format-4-lab.mcap"


def test_a_report_is_packed_and_its_contents_are_printed(tmp_path):
    (tmp_path / "lab.txt").write_text("ask ada@uni.edu")
    done = tetractl(tmp_path, "lab", "bundle", LOG, "lab.txt", "-o", "report.zip").ok()
    lines = done.stdout.splitlines()
    assert lines[0].startswith("logs/000-format-4-lab.mcap: ")
    assert lines[1] == "files/lab.txt: text"
    assert "persons: 1" in done.stdout
    assert lines[-1] == "wrote report.zip: look at its contents before you send it"
    again = tetractl(tmp_path, "lab", "bundle", LOG, "-o", "report.zip")
    assert again.returncode == 2 and "exists already" in again.stderr
