"""Tests of `plot`: the name of the image, the figure that is drawn, and the exit code."""

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest

from tetractl.cli import plot as module
from tetractl.cli.plot import _default_name, plot
from tetractl.core.errors import Exit, UsageError


@pytest.mark.parametrize(
    ("logs", "name"),
    [
        (["/a/batch/trial-003.mcap"], "trial-003-errors.png"),
        (["/a/batch/trial-003.mcap.part"], "trial-003-errors.png"),
        (["/a/batch/trial-003.recovered.mcap"], "trial-003.recovered-errors.png"),
        (["/a/batch/x.mcap", "/a/batch/y.mcap"], "batch-errors.png"),
        (["/a/one/x.mcap", "/a/two/y.mcap"], "a-errors.png"),
        (["/one/x.mcap", "/two/y.mcap"], "trials-errors.png"),
    ],
)
def test_an_image_is_named_after_its_log_or_the_folder_of_all(logs, name):
    assert _default_name([Path(log) for log in logs], "errors") == Path(name)


@pytest.fixture
def drawn(monkeypatch):
    """Draw nothing; returns what would be drawn and saved."""
    done = SimpleNamespace(saved=[], damage={}, speed=1, drawn=[])
    monkeypatch.setattr(module, "find_logs", lambda logs: [Path(log) for log in logs])
    monkeypatch.setattr(
        module.ui, "open_trial", lambda path: SimpleNamespace(damage=done.damage.get(path.name))
    )
    monkeypatch.setattr(module.ui, "show_progress", lambda what: nullcontext())
    monkeypatch.setattr(
        "tetractl.view.figures.draw.draw", lambda kind, trials: done.drawn.append(kind)
    )
    monkeypatch.setattr(
        "tetractl.view.style.save", lambda figure, path: done.saved.append(str(path))
    )

    def write_video(log, path, on_picture):
        done.saved.append(str(path))
        return done.speed

    monkeypatch.setattr("tetractl.view.video.write_video", write_video)
    return done


def test_paths_are_drawn_unless_another_figure_is_named(drawn, capsys):
    assert plot(["a.mcap"]) == Exit.DONE
    assert plot(["a.mcap", "b.mcap"], Path("x.svg"), "errors") == Exit.DONE
    assert drawn.drawn == ["trajectory", "errors"]
    assert drawn.saved == ["a-trajectory.png", "x.svg"]
    assert capsys.readouterr().out.split() == drawn.saved


def test_a_damaged_log_is_drawn_and_fails(drawn):
    drawn.damage = {"b.mcap": "torn"}
    assert plot(["a.mcap", "b.mcap"]) == Exit.FAILED
    assert plot(["a.mcap"]) == Exit.DONE
    assert plot(["b.mcap"], kind="video") == Exit.FAILED
    assert len(drawn.saved) == 3


@pytest.mark.parametrize(
    ("out", "kind"), [(Path("x.doc"), None), (Path("x.png"), "nonsense"), (Path("x.png"), "video")]
)
def test_an_unknown_form_or_figure_is_refused_before_anything_is_drawn(drawn, out, kind):
    with pytest.raises(UsageError):
        plot(["a.mcap"], out, kind)
    assert drawn.saved == []


def test_a_video_is_of_one_trial_and_tells_its_speed(drawn, capsys):
    assert plot(["a.mcap"], kind="video") == Exit.DONE
    said = capsys.readouterr()
    assert (said.out, said.err) == ("a-video.gif\n", "")
    drawn.speed = 4
    plot(["a.mcap"], Path("x.webp"), "video")
    said = capsys.readouterr()
    assert said.out == "x.webp\n"
    assert "the video plays 4 times faster than the trial" in said.err
    with pytest.raises(UsageError, match="a video shows a single trial, but 2 are given"):
        plot(["a.mcap", "b.mcap"], kind="video")
