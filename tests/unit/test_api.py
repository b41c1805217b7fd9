"""Tests of the public API: every name of `import tetractl`, used as in a notebook."""

import csv
import re
import signal
import subprocess
import sys
import traceback
from pathlib import Path

import numpy as np
import pytest
import yaml
from testkit.paths import ROOT

import tetractl
from tetractl.core.errors import AbortError, SpecError, UsageError
from tetractl.run import executors
from tetractl.spec.plants import select_plant

SPEC = """
name: two
arena: {left: 0, bottom: 0, width: 1000, height: 1000}
robots:
  - {name: a, start: [200, 500], target: [600, 500], a: 6, speed: 180}
  - {name: b, start: [200, 700], target: [500, 800], a: 3, speed: 150}
controller: {type: pso-mpc, period: 0.2, horizon_max: 8, steps_max: 6}
plant: {measurement_noise: {position: 2}}
trials: {count: 3, seed: 4}
"""


class Watch:
    """An observer that calls `on_step` alone."""

    def __init__(self, on_step):
        self.on_step = on_step

    def on_start(self, start):
        pass

    on_samples = on_command = on_note = on_start

    def on_stop(self, stop, result):
        pass


@pytest.fixture(scope="module")
def batch(tmp_path_factory):
    folder = tmp_path_factory.mktemp("batch")
    results = {}
    finished = tetractl.run_batch(tetractl.parse_spec(SPEC), folder, on_result=results.__setitem__)
    assert sorted(results) == [0, 1, 2]
    return folder, finished


@pytest.mark.long
def test_a_notebook(tmp_path, batch):
    """Load, run, read, tabulate, summarise, compare, draw, verify."""
    (tmp_path / "two.yaml").write_text(SPEC, encoding="utf-8")
    spec = tetractl.load_spec(tmp_path / "two.yaml", "trials.seed=9")
    assert isinstance(spec.experiment, tetractl.Experiment)
    assert spec.experiment.trials.seed == 9

    trial = tetractl.run_trial(spec, 1, folder=tmp_path / "one")
    logged = tetractl.read_log(tmp_path / "one" / "trial-001.mcap")
    assert isinstance(trial, tetractl.TrialLog)
    assert trial.digest == logged.digest
    assert trial.log == logged.log

    folder, ours = batch
    theirs = tetractl.run_batch(spec, tmp_path / "theirs")
    for of_batch in (ours, tetractl.read_batch(folder), theirs):
        assert len(of_batch.trials) == 3
    summary = tetractl.summarise(ours)
    assert summary.counted == 3
    summary_of_theirs = tetractl.summarise(theirs)
    comparison = tetractl.compare(summary, summary_of_theirs)
    (contrast,) = comparison.contrasts
    difference = summary.total.mean - summary_of_theirs.total.mean
    assert contrast.difference.value == pytest.approx(difference)
    for data in (trial, [trial, logged], summary, comparison):
        tetractl.plot(data, file=tmp_path / "figure.png")
        assert (tmp_path / "figure.png").stat().st_size > 5000
        (tmp_path / "figure.png").unlink()
    assert tetractl.plot(trial, "errors").axes
    assert tetractl.verify(folder / "trial-000.mcap").ok


def test_arrays_and_tables_hold_the_trial(batch):
    import pandas  # slow to import

    folder, finished = batch
    trial = tetractl.read_log(folder / "trial-000.mcap")
    arrays = tetractl.to_arrays(trial)
    frames = len(trial.mocap_ns)
    steps = len(trial.steps)
    assert arrays.poses.shape == arrays.truth.shape == (frames, 2, 3)
    assert arrays.distance.shape == arrays.valid.shape == (frames, 2)
    assert arrays.direction.shape == arrays.cost.shape == arrays.solve_ms.shape == (steps,)
    assert arrays.distance[0] == pytest.approx(np.hypot([400, 300], [0, 100]), abs=10)
    assert np.diff(arrays.step_time_s) == pytest.approx(0.2)
    assert arrays.length[0] == len(trial.steps[0].plan.signals)
    assert arrays.evaluations[0] == trial.steps[0].plan.evaluations

    course = tetractl.to_dataframe(trial)
    assert isinstance(course, pandas.DataFrame)
    assert len(course) == 2 * frames
    b = course.query("robot == 'b'")
    assert b.distance_mm.to_numpy().tobytes() == arrays.distance[:, 1].tobytes()
    assert b.true_y_mm.to_numpy().tobytes() == arrays.truth[:, 1, 1].tobytes()
    ends = tetractl.to_dataframe(finished)
    assert list(ends.trial) == [0, 1, 2]
    assert ends.total_error_mm.mean() == pytest.approx(tetractl.summarise(finished).total.mean)


def test_a_batch_goes_on_where_it_stopped(batch, tmp_path):
    spec = tetractl.parse_spec(SPEC, "trials.count=1")
    tetractl.run_batch(spec, tmp_path)
    says = "holds logs already\nhint: name another folder with folder=, or add resume=True"
    with pytest.raises(UsageError, match=says):
        tetractl.run_batch(spec, tmp_path)
    run = []
    resumed = tetractl.run_batch(
        tetractl.parse_spec(SPEC), tmp_path, resume=True, on_result=lambda t, _: run.append(t)
    )
    assert run == [1, 2]
    _, finished = batch
    errors = [trial.result.total_error for trial in finished.trials]
    assert [trial.result.total_error for trial in resumed.trials] == errors


def test_what_cannot_be_run_is_refused(tmp_path):
    spec = tetractl.parse_spec(SPEC)
    tetractl.run_trial(spec, folder=tmp_path)
    with pytest.raises(UsageError, match=r"trial-000\.mcap: exists already") as caught:
        tetractl.run_trial(spec, folder=tmp_path)
    assert traceback.format_exception(caught.value)[-1].endswith("\nhint: name another folder\n")
    with pytest.raises(SpecError, match="unknown key"):
        tetractl.parse_spec(SPEC, "controller.perod=1")
    lab = ROOT / "experiments" / "three_m3pi_lab.yaml"
    with pytest.raises(UsageError, match="plant is the lab"):
        tetractl.run_trial(select_plant(tetractl.load_spec(lab), "lab"))


def test_ctrl_c_ends_a_trial_and_is_raised_again(tmp_path):
    def interrupt(step):
        if step.k == 1:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        tetractl.run_trial(tetractl.parse_spec(SPEC), folder=tmp_path, observers=[Watch(interrupt)])
    (ended,) = tetractl.read_batch(tmp_path).trials
    assert ended.outcome is tetractl.Outcome.INTERRUPTED
    assert ended.result.steps == 2


@pytest.mark.long
def test_a_path_or_a_dict_is_taken_where_an_object_is_asked(tmp_path):
    contents = yaml.safe_load(SPEC)
    batch = tetractl.run_batch(contents, tmp_path)
    log = tmp_path / "trial-000.mcap"
    assert tetractl.run_trial(contents).start.seed == tetractl.read_log(log).start.seed
    assert tetractl.to_arrays(log).poses.shape == tetractl.to_arrays(str(log)).poses.shape
    assert len(tetractl.to_dataframe(tmp_path)) == len(batch.trials)
    assert tetractl.summarise(tmp_path).total == tetractl.summarise(batch).total
    assert len(tetractl.compare(tmp_path, batch).groups) == 2
    assert tetractl.plot(log).axes
    assert tetractl.plot(tmp_path, "errors").axes
    assert tetractl.plot(batch, "errors").axes
    assert tetractl.summarise([log]).total.n == 1
    assert tetractl.parse_spec(contents).experiment == tetractl.parse_spec(SPEC).experiment


def test_a_study_is_run_from_its_contents(tmp_path):
    """Also its base is what a script has in hand."""
    study = {
        "name": "turning",
        "base": yaml.safe_load(SPEC),
        "sweep": {"type": "grid", "fields": {"robots.0.a": [2, 3]}},
        "trials": {"count": 1, "seed": 1},
    }
    arms = tetractl.run_study(study, tmp_path / "logs", progress=False)
    assert [len(batch.trials) for batch in arms.values()] == [1, 1]
    assert list(arms) == ["a=2", "a=3"]


@pytest.mark.parametrize("fails", ["a=2", "a=3"])
def test_a_trial_of_a_study_that_fails_is_raised_when_all_others_are_written(
    tmp_path, monkeypatch, fails
):
    """Also the table and the figures of what ended, as the command writes them."""
    study = {
        "name": "turning",
        "base": yaml.safe_load(SPEC),
        "sweep": {"type": "grid", "fields": {"robots.0.a": [2, 3]}},
        "trials": {"count": 2, "seed": 1},
    }
    run_task = executors.run_task

    def run(task, *args):
        if (task.arm, task.trial) == (fails, 0):
            raise AbortError("the disk is full")
        return run_task(task, *args)

    monkeypatch.setattr(executors, "run_task", run)
    folder = tmp_path / "logs"
    with pytest.raises(AbortError, match="the disk is full"):
        tetractl.run_study(study, folder, progress=False)
    with (folder / "trials.csv").open(newline="") as file:
        rows = [(row["arm"], row["trial"]) for row in csv.DictReader(file)]
    assert sorted(rows) == [(arm, trial) for arm in ("a=2", "a=3") for trial in ("0", "1")
                            if (arm, trial) != (fails, "0")]  # fmt: skip
    assert list(folder.glob("*.png"))
    monkeypatch.undo()
    arms = tetractl.run_study(study, folder, progress=False)
    assert [len(batch.trials) for batch in arms.values()] == [2, 2]


NOT_TAKEN = {
    "a spec's file": (lambda: tetractl.load_spec(yaml.safe_load(SPEC)), "parse_spec takes a dict"),
    "a study": (lambda: tetractl.run_study(3), "a study must be a file or a dict"),
    "a study's folder": (lambda: tetractl.run_study({}, 3), "the folder must be a path"),
    "a batch's folder": (lambda: tetractl.run_batch(SPEC_DICT, None), "the folder must be a path"),
    "a trial's folder": (
        lambda: tetractl.run_trial(SPEC_DICT, folder=3),
        "the folder must be a path",
    ),
    "a trial's number": (
        lambda: tetractl.run_trial(SPEC_DICT, "5"),
        "a trial must be a whole number",
    ),
    "a negative trial": (
        lambda: tetractl.run_trial(SPEC_DICT, -1),
        "a trial must be a whole number",
    ),
    "a stepped trial": (
        lambda: tetractl.open_trial(SPEC_DICT, 1.5),
        "a trial must be a whole number",
    ),
    "a seed": (
        lambda: tetractl.open_trial(SPEC_DICT, 0, -1),
        "a seed must be a whole number of at least 0",
    ),
}
SPEC_DICT = yaml.safe_load(SPEC)


@pytest.mark.parametrize("name", NOT_TAKEN)
def test_an_argument_of_another_type_is_refused_in_one_line(name):
    """Regression: TypeErrors and ValueErrors of what the argument was passed on to."""
    call, words = NOT_TAKEN[name]
    with pytest.raises(UsageError, match=words) as error:
        call()
    assert "\n" not in error.value.message


def test_an_interrupted_batch_says_how_its_trials_are_read(tmp_path):
    folder = tmp_path / "logs"
    with pytest.raises(KeyboardInterrupt) as caught:
        tetractl.run_batch(
            tetractl.parse_spec(SPEC),
            folder,
            on_result=lambda trial, result: signal.raise_signal(signal.SIGINT),
        )
    said = str(caught.value)
    assert said.startswith(f"`read_batch({str(folder)!r})` reads the trials that have ended")
    assert "with resume=True, this function runs the others" in said
    assert len(tetractl.read_batch(folder).trials) == 1


@pytest.mark.parametrize("progress", [True, False])
def test_a_batch_says_that_code_is_compiled(tmp_path, monkeypatch, capsys, progress):
    def warm_up(experiment, announce):
        announce("compiling for pso-mpc")

    monkeypatch.setattr("tetractl.control.methods.build.warm_up", warm_up)
    spec = tetractl.parse_spec(SPEC, "trials.count=1")
    tetractl.run_batch(spec, tmp_path, progress=progress)
    assert capsys.readouterr().err == ("compiling for pso-mpc\n" if progress else "")


def test_a_single_trial_says_that_code_is_compiled(monkeypatch, capsys):
    """Regression: the first trial in a notebook was silent for half a minute."""
    monkeypatch.setattr(
        "tetractl.control.methods.build.warm_up", lambda experiment, announce: announce("compiling")
    )
    tetractl.run_trial(tetractl.parse_spec(SPEC))
    tetractl.open_trial(tetractl.parse_spec(SPEC))
    assert capsys.readouterr().err == "compiling\n" * 2


def test_every_name_is_there_and_no_other():
    for name in tetractl.__all__:
        assert getattr(tetractl, name) is not None, name
    assert dir(tetractl) == sorted(tetractl.__all__)
    assert "properties" in tetractl.experiment_schema()
    for protocol in ("Actuator", "Camera", "Controller", "Observer", "Optimizer"):
        assert getattr(tetractl, protocol)._is_protocol, protocol
    with pytest.raises(AttributeError, match="no attribute 'run_trail'"):
        _ = tetractl.run_trail  # pyright: ignore[reportAttributeAccessIssue]


def test_importing_the_face_imports_next_to_nothing():
    code = "import sys; old = {*sys.modules}; import tetractl; print(*({*sys.modules} - old))"
    command = [sys.executable, "-S", "-c", code]
    path = {"PYTHONPATH": str(Path(tetractl.__file__).parents[1])}
    done = subprocess.run(command, env=path, capture_output=True, text=True, check=True)
    assert len(done.stdout.split()) < 10, done.stdout
    assert not {"numpy", "numba", "pydantic", "typing"} & {*done.stdout.split()}


@pytest.mark.parametrize("data", [3, None, {}, [3]], ids=repr)
@pytest.mark.parametrize("name", ["summarise", "compare", "plot", "to_dataframe", "verify"])
def test_what_is_no_trial_and_no_batch_is_refused_in_one_line(name, data):
    """Regression: AttributeError, TypeError and IndexError, whose words were of other things."""
    with pytest.raises(UsageError) as error:
        getattr(tetractl, name)(data)
    assert "\n" not in error.value.message


@pytest.mark.parametrize("progress", [True, False])
def test_a_batch_says_now_and_then_how_far_it_is(tmp_path, monkeypatch, capsys, progress):
    """Regression: a batch of 372 s said no word."""
    monkeypatch.setattr("tetractl.view.terminal.progress.LINE_INTERVAL_S", 0.0)
    tetractl.run_batch(tetractl.parse_spec(SPEC), tmp_path, progress=progress)
    printed = capsys.readouterr()
    first, *rest = printed.err.splitlines() or [""]
    assert printed.out == ""
    if progress:
        assert re.fullmatch(r"1 of 3 trials; \d+ s left", first)
        assert len(rest) == 2
    else:
        assert printed.err == ""


def test_a_trial_that_is_kept_nowhere_is_the_one_of_the_batch(batch, tmp_path):
    folder, _ = batch
    before = set(Path.cwd().iterdir())
    steps = []
    trial = tetractl.run_trial(tetractl.parse_spec(SPEC), 2, observers=[Watch(steps.append)])
    logged = tetractl.read_log(folder / "trial-002.mcap")
    assert trial.mocap.tobytes() == logged.mocap.tobytes()
    assert trial.result is not None
    assert trial.result.outcome in tetractl.Outcome
    assert [step.k for step in steps] == list(range(len(trial.steps)))
    assert isinstance(trial.steps[0].plan, tetractl.Plan)
    assert isinstance(trial.steps[0].observation, tetractl.Observation)
    assert isinstance(trial.steps[0].observation.poses, tetractl.Poses)
    assert trial.log == "spec, trial 2"
    assert set(Path.cwd().iterdir()) == before


def test_without_pandas_one_line_says_so(batch, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(tetractl.TetractlError, match="a DataFrame needs pandas") as raised:
        tetractl.to_dataframe(batch[1])
    assert "to_arrays" in str(raised.value.hint)


def test_problems_of_contents_name_no_line_of_a_text_that_nobody_wrote(tmp_path):
    contents = yaml.safe_load(SPEC)
    with pytest.raises(SpecError, match=r"^spec: name: 3: must be text"):
        tetractl.run_trial(contents | {"name": 3})
    with pytest.raises(SpecError, match=r"^base: name: 3: must be text"):
        tetractl.run_study({"name": "s", "base": contents | {"name": 3}}, tmp_path)
    with pytest.raises(SpecError, match=r"^study: base: 5: must be text"):
        tetractl.run_study({"name": "s", "base": 5}, tmp_path)


def test_another_object_is_refused_in_one_line():
    with pytest.raises(
        UsageError,
        match=r"^a spec must be a file, a dict or .* but the value given is of type int$",
    ):
        tetractl.run_trial(5)  # pyright: ignore[reportArgumentType]
    with pytest.raises(
        UsageError,
        match=r"^a trial must be the file of a log, or .* but the value given is of type int$",
    ):
        tetractl.to_arrays(5)  # pyright: ignore[reportArgumentType]
    contents = yaml.safe_load(SPEC) | {"name": np.zeros(3)}
    with pytest.raises(SpecError, match=r"^spec: Object of type ndarray"):
        tetractl.run_trial(contents)


def test_folders_that_are_compared_have_their_own_names(tmp_path):
    for name in ("early", "late"):
        tetractl.run_trial(SPEC_DICT, folder=tmp_path / name)
    comparison = tetractl.compare(tmp_path / "early", tetractl.read_batch(tmp_path / "late"))
    assert [group.name for group in comparison.groups] == ["early", "late"]


def test_the_package_has_no_names_but_its_own():
    assert not hasattr(tetractl, "TYPE_CHECKING")


def test_a_folder_is_not_verified_as_one_log(tmp_path):
    with pytest.raises(
        UsageError, match="this is a folder, but verify reads a single log"
    ) as refused:
        tetractl.verify(tmp_path)
    assert "read_batch" in refused.value.hint
