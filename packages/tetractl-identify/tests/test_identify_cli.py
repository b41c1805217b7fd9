"""Tests of the command `tetractl identify`, started as a user would."""

import json

import pytest
import yaml
from testkit.cli import tetractl
from testkit.usage import command_of, refused_in_one_line

pytestmark = pytest.mark.slow

USAGE = """
identify | LOG
identify logs -o no/found.yaml | no/found.yaml: the folder no
identify tables | tables: this folder contains no logs (*.mcap) | if these are tables, give the
identify tables/poses.csv tables/poses.csv | poses.csv: this file is given twice | name both files
identify logs --yes | No such option
identify logs poses.csv | logs cannot be combined with CSV files
"""


@pytest.fixture(scope="module")
def identified(folder):
    """What `identify` wrote of the folder's logs: `found.yaml`, which `better.yaml` takes up."""
    done = tetractl(folder, "identify", "logs", "-o", "found.yaml").ok()
    assert "2 logs" in done.stdout and "disturbed simulation" in done.stdout
    spec = (folder / "quick.yaml").read_text()
    (folder / "better.yaml").write_text(spec + "identified: found.yaml\n")
    return yaml.safe_load((folder / "found.yaml").read_text())


def resolved(folder, *words):
    """The spec `better.yaml` as a run would take it."""
    done = tetractl(folder, "run", "better.yaml", "--dry-run", *words).ok()
    return yaml.safe_load(done.stdout)


@pytest.mark.long
def test_a_batch_is_identified(identified):
    assert identified["dead_time"]["value"] == pytest.approx(0.1, abs=0.01)
    assert identified["robots"]["two"]["a"]["value"] == pytest.approx(3, rel=0.05)


def test_a_spec_takes_its_numbers_from_the_file(folder, identified):
    spec = resolved(folder)
    rates = {robot["name"]: robot["a"] for robot in spec["robots"]}
    assert rates == {name: identified["robots"][name]["a"]["value"] for name in ("one", "two")}
    dead_time = identified["dead_time"]["value"] + identified["frame_age"]
    assert spec["controller"]["dead_time"] == dead_time
    assert spec["identified"] is None


@pytest.mark.usefixtures("identified")
def test_what_was_identified_is_not_overwritten(folder):
    again = tetractl(folder, "identify", "logs", "-o", "found.yaml")
    assert again.returncode == 2
    assert "exists already" in again.stderr


@pytest.mark.long
def test_what_is_identified_from_a_damaged_log_is_told_with_a_failure(folder, tmp_path):
    torn = tmp_path / "torn.mcap"
    torn.write_bytes((folder / "logs/trial-000.mcap").read_bytes()[:-200])
    done = tetractl(folder, "identify", str(torn))
    assert (done.returncode, "dead time" in done.stdout) == (1, True)


def identified_json(folder, *words):
    return json.loads(tetractl(folder, "identify", *words, "--json").ok().stdout)


@pytest.mark.long
def test_exported_tables_say_the_same(folder):
    assert tetractl(folder, "export", "logs", "-o", "tables").returncode == 0
    from_logs = identified_json(folder, "logs")
    from_tables = identified_json(folder, "tables/poses.csv", "tables/steps.csv")
    assert from_tables["origin"] == "CSV"
    dead_time = from_logs["dead_time"]["value"]
    assert from_tables["dead_time"]["value"] == pytest.approx(dead_time, abs=1e-4)
    for expected, robot in zip(from_logs["robots"], from_tables["robots"], strict=True):
        assert robot["a"]["value"] == pytest.approx(expected["a"]["value"], rel=1e-3)


@pytest.mark.long
def test_logs_of_a_field_of_known_strength_say_the_rate_per_strength(folder):
    text = (folder / "quick.yaml").read_text() + "strength: 4.0\n"
    (folder / "field.yaml").write_text(text.replace("a: 3", "a: {per_mT: 0.75}"))
    tetractl(folder, "run", "field.yaml", "--out", "field", "--trials", "1", "--quiet").ok()
    done = tetractl(folder, "identify", "field", "-o", "field-found.yaml").ok()
    assert "a per strength [rad/(s mT)]" in done.stdout
    (folder / "field-better.yaml").write_text(
        (folder / "field.yaml").read_text() + "identified: field-found.yaml\n"
    )
    dry = tetractl(folder, "run", "field-better.yaml", "--dry-run", "--set", "strength=2").ok()
    robots = {robot["name"]: robot for robot in yaml.safe_load(dry.stdout)["robots"]}
    assert robots["two"]["a"]["per_mT"] == pytest.approx(0.75, rel=0.05)
    mixed = tetractl(folder, "identify", "field", "logs")
    assert (mixed.returncode, "the field's strength differs" in mixed.stderr) == (2, True)


# a robot that turns to and fro, every second, and its commands, 0.1 s before
POSES = "\n".join(f"{k / 50},one,{k},0,{0.2 * abs(k / 50 % 2 - 1)}" for k in range(300))
DRIVEN = {
    "speeds": ("time_s,v_mm_s,w_rad_s", "{t},50,{w}"),
    "wheels": ("time_s,robot,left_mm_s,right_mm_s,radius_mm", "{t},one,{left},{right},40"),
    "slow": ("time_s,v_mm_s,w_rad_s", "{t},0,0"),
    "even": ("time_s,v_mm_s,w_rad_s", "{t},50,0.2"),
}


@pytest.mark.long
def test_speeds_and_turning_rates_are_identified_from_tables(tmp_path):
    (tmp_path / "poses.csv").write_text(f"time_s,robot,x_mm,y_mm,heading_rad\n{POSES}")
    for name, (head, row) in DRIVEN.items():
        turns = [(k / 20, -0.2 if (k + 2) // 20 % 2 == 0 else 0.2) for k in range(120)]
        rows = [row.format(t=t, w=w, left=50 - 40 * w, right=50 + 40 * w) for t, w in turns]
        (tmp_path / f"{name}.csv").write_text("\n".join([head, *rows]))

    def identify(name, *words):
        return tetractl(tmp_path, "identify", "poses.csv", f"{name}.csv", *words)

    (by_speeds,) = json.loads(identify("speeds", "--json").ok().stdout)
    (by_wheels,) = json.loads(identify("wheels", "--json").ok().stdout)
    gain = by_speeds["turning_gain"]["value"]
    assert gain == pytest.approx(by_wheels["turning_gain"]["value"], rel=1e-6)
    assert gain == pytest.approx(1.0, abs=0.1)
    assert by_speeds["dead_time"]["value"] == pytest.approx(0.1, abs=0.05)
    assert "turning gain" in identify("speeds").ok().stdout
    assert "the data do not determine" in identify("even").ok().stdout
    for name, words, why in (
        ("slow", (), "robot one drives in only 0 of the steps between its poses"),
        ("speeds", ("-o", "out.yaml"), "--out cannot be combined with --wheels"),
    ):
        done = identify(name, *words)
        assert done.returncode == 2 and why in done.stderr, done.stderr


@pytest.mark.parametrize("row", USAGE.strip().splitlines(), ids=command_of)
def test_what_is_typed_wrong_is_one_line_with_a_hint_and_changes_nothing(folder, row):
    table = folder / "tables" / "poses.csv"
    table.parent.mkdir(exist_ok=True)
    table.write_text("time_s,robot,x_mm,y_mm,heading_rad\n0,green,0,0,0\n", encoding="utf-8")
    refused_in_one_line(folder, 2, row)
