"""Tests of the command `identify`: what it reads, what it refuses, and where it writes."""

from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from tetractl_identify import identify_command as module
from tetractl_identify.identify_command import identify

from tetractl.core.errors import Exit, UsageError
from tetractl.spec.identified import Identified


@pytest.fixture
def command(monkeypatch):
    """The command with made-up logs and tables; it keeps what it fits."""
    asked = SimpleNamespace(fitted=None, responded=None, damage={}, undirected=(), speeds=False)

    def track(path, speeds=False):
        return SimpleNamespace(
            source=path, sent_s=[0.0, 1.0], origin="lab", unit="mm", remarks=(f"of {path}",),
            twists=SimpleNamespace(size=4 if speeds else 0),
        )  # fmt: skip

    def open_trial(path):
        direction = None if path in asked.undirected else 0.5
        return SimpleNamespace(
            path=path,
            damage=asked.damage.get(path),
            commands=[SimpleNamespace(direction=None), SimpleNamespace(direction=direction)],
            start=SimpleNamespace(setup=SimpleNamespace(a=f"a of {path}")),
            experiment=SimpleNamespace(
                controller=SimpleNamespace(dead_time=f"dead time of {path}")
            ),
        )

    def fit(tracks, a=None, dead_time=None):
        asked.fitted = ([track.source for track in tracks], a, dead_time)
        return "robots"

    def fit_responses(tracks):
        asked.responded = [track.source for track in tracks]
        return ["response"]

    section = Identified.model_validate(
        {"identified": "now", "origin": "lab", "unit": "mm", "dead_time": {"value": 0.1},
         "robots": {}}
    )  # fmt: skip
    place = "tetractl_identify"
    monkeypatch.setattr(module, "find_logs", list)
    monkeypatch.setattr(module.ui, "open_trial", open_trial)
    monkeypatch.setattr(
        f"{place}.tracks.extract_track", lambda trial: track(f"directions of {trial.path}")
    )
    monkeypatch.setattr(
        f"{place}.tracks.extract_wheel_track", lambda trial: track(f"wheels of {trial.path}")
    )
    monkeypatch.setattr(f"{place}.tracks.require_same", lambda tracks: None)
    monkeypatch.setattr(
        f"{place}.csv_tracks.read_csv_tracks",
        lambda paths: [track(str(path), asked.speeds) for path in paths],
    )
    monkeypatch.setattr(f"{place}.identify.identify", fit)
    monkeypatch.setattr(f"{place}.identify.remove_unsure_intervals", lambda robots: robots)
    monkeypatch.setattr(f"{place}.identify.tables", lambda robots: [])
    monkeypatch.setattr(f"{place}.identify.create_spec_section", lambda robots, when: section)
    monkeypatch.setattr(f"{place}.response.fit_responses", fit_responses)
    monkeypatch.setattr(f"{place}.robot_response.create_response_table", lambda *args: args[1])
    monkeypatch.setattr(
        module.ui,
        "print_results",
        lambda as_json, items, tables: print("json" if as_json else tables),
    )
    return asked


A, B = Path("a.mcap"), Path("b.mcap")
POSES, STEPS = Path("poses.csv"), Path("steps.CSV")


def test_logs_are_fitted_with_the_expected_values_of_the_first(command):
    assert identify([A, B]) == Exit.DONE
    assert command.fitted == (
        ["directions of a.mcap", "directions of b.mcap"], "a of a.mcap", "dead time of a.mcap",
    )  # fmt: skip
    assert command.responded is None


def test_tables_are_fitted_without_expected_values_and_their_remarks_told(command, capsys):
    assert identify([POSES, STEPS]) == Exit.DONE
    assert command.fitted == (["poses.csv", "steps.CSV"], None, None)
    assert capsys.readouterr().err.splitlines() == [
        "warning: of poses.csv", "warning: of steps.CSV",
    ]  # fmt: skip


def test_wheels_of_logs_and_speeds_of_tables_are_responses(command, capsys):
    assert identify([A], wheels=True) == Exit.DONE
    assert command.responded == ["wheels of a.mcap"]
    assert capsys.readouterr().out == "['2 commands: lab; 95 % intervals']\n"
    command.speeds = True
    assert identify([POSES, STEPS]) == Exit.DONE
    assert command.responded == ["poses.csv", "steps.CSV"]
    assert command.fitted is None


@pytest.mark.parametrize("mixed", [[A, POSES], [POSES, A], [POSES, STEPS, B]])
def test_logs_and_tables_are_not_combined(command, mixed):
    with pytest.raises(UsageError, match=r"^[ab]\.mcap: the name does not end in \.csv"):
        identify(mixed)


def test_a_log_without_directions_is_left_out(command, capsys):
    command.undirected = (A,)
    assert identify([A, B]) == Exit.DONE
    assert command.fitted == (["directions of b.mcap"], "a of b.mcap", "dead time of b.mcap")
    assert "warning: a.mcap: this log has no direction" in capsys.readouterr().err
    command.undirected = (A, B)
    with pytest.raises(UsageError, match="no direction was sent in any of the logs"):
        identify([A, B])


@pytest.mark.parametrize("damaged", [A, B])
def test_a_damaged_log_is_used_but_fails(command, damaged):
    command.damage = {damaged: "torn"}
    assert identify([A, B]) == Exit.FAILED
    assert len(command.fitted[0]) == 2


def test_values_are_written_for_a_spec(command, tmp_path, capsys):
    out = tmp_path / "found.yaml"
    assert identify([A], out=out) == Exit.DONE
    assert yaml.safe_load(out.read_text())["dead_time"] == {"value": 0.1}
    assert "add this line to the spec: identified: found.yaml" in capsys.readouterr().out
    with pytest.raises(UsageError, match="exists already"):
        identify([A], out=out)


def test_json_is_all_that_is_printed(command, tmp_path, capsys):
    assert identify([A], out=tmp_path / "found.yaml", as_json=True) == Exit.DONE
    assert capsys.readouterr().out == "json\n"
    assert (tmp_path / "found.yaml").is_file()


def test_a_response_has_no_place_in_a_spec(command, tmp_path):
    out = tmp_path / "found.yaml"
    with pytest.raises(UsageError, match="--out cannot be combined with --wheels"):
        identify([A], out=out, wheels=True)
    command.speeds = True
    with pytest.raises(UsageError, match="--out cannot be combined with --wheels"):
        identify([POSES, STEPS], out=out)
    assert command.responded is None
    assert not out.exists()
