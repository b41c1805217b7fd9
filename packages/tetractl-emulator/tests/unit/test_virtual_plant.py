"""Tests of the plant `emulated`: what it says about its devices, and how slow it makes plans."""

import json

import numpy as np
import pytest
from testkit.emulator.acting import act
from testkit.emulator.lab_processes import SPEC
from testkit.paths import EXAMPLES
from tetractl_emulator.virtual_lab import LabClock, LiveClock

from tetractl.core.clock import SECOND
from tetractl.core.commands import Steer, Stop
from tetractl.core.errors import AbortError, UsageError
from tetractl.core.protocols import LabSupervision
from tetractl.core.trial import EMULATED_DEVICES_FACT, REAL_DEVICE_FACT
from tetractl.spec.load import load_spec
from tetractl.spec.plants import select_plant

EXPERIMENT = select_plant(load_spec(SPEC), "emulated").experiment
DOUBLED = {"about": "doubled", "faults": [{"fault": "doubled_frames", "since": "start"}]}


def section(**fields):
    return EXPERIMENT.plant.model_copy(update=fields)


@pytest.mark.parametrize(
    ("real", "real_time", "devices"),
    [
        (None, False, ("camera", "actuator")),
        ("camera", True, ("actuator",)),
        ("actuator", True, ("camera",)),
    ],
)
def test_time_is_virtual_unless_a_device_is_real(real, real_time, devices):
    made = section(real=real)
    assert made.real_time == real_time
    assert made.emulated_devices == devices
    assert type(made.clock()) is (LiveClock if real_time else LabClock)
    halves = {} if real is None else {REAL_DEVICE_FACT: real, EMULATED_DEVICES_FACT: devices[0]}
    assert made.halves() == halves
    assert halves.items() <= made.bounds().items()
    assert (REAL_DEVICE_FACT in made.bounds()) == real_time


def test_only_real_robots_cannot_be_calibrated():
    section().require_calibratable()
    section(real="camera").require_calibratable()
    with pytest.raises(UsageError, match="they cannot be calibrated"):
        section(real="actuator").require_calibratable()


def test_a_script_is_read_from_the_folder_of_the_spec(tmp_path):
    (tmp_path / "script.yaml").write_text(json.dumps(DOUBLED))
    assert section(faults="script.yaml").with_files(tmp_path).faults == DOUBLED
    for faults in (None, DOUBLED):
        assert section(faults=faults).with_files(tmp_path).faults == faults


@pytest.mark.parametrize("faults", ["none.yaml", "bad.yaml"])
def test_a_script_that_is_missing_or_invalid_is_an_error_of_the_spec(tmp_path, faults):
    (tmp_path / "bad.yaml").write_text("faults: [{fault: earthquake}]\n")
    with pytest.raises(UsageError):
        section(faults=faults).with_files(tmp_path)


class Trial:
    """An opened plant of a trial in virtual time."""

    def __init__(self, seed=1, spawned=(0,), **fields):
        made = section(**fields)
        self.clock = made.clock()
        self.sequence = np.random.SeedSequence(seed, spawn_key=spawned)
        self.plant = made.build(EXPERIMENT.setup, self.clock, self.sequence, LabSupervision())

    def __enter__(self):
        self.info = self.plant.open()
        return self

    def __exit__(self, *_):
        self.plant.close()

    def plan_s(self):
        """How long it takes to send the action that is planned from a frame [s]."""
        self.plant.observe()
        began_ns = self.clock.now()
        self.plant.send(Steer(0.0))
        return (self.clock.now() - began_ns) / SECOND


@pytest.mark.slow
def test_a_plan_takes_no_time_unless_the_computer_is_busy():
    with Trial() as trial:
        assert trial.info.kind == "emulated"
        assert REAL_DEVICE_FACT not in trial.info.facts
        assert trial.plan_s() < 0.005
        busy = act(trial.clock.acting, "busy", seconds=0.04, every=2)
        took = [trial.plan_s() for _ in range(4)]
        trial.clock.acting.remove(busy)
        took.append(trial.plan_s())
    late = [0.04, 0.0, 0.04, 0.0, 0.0]  # the second, fourth ... plan
    assert took == pytest.approx(late, abs=0.003)


@pytest.mark.slow
def test_an_action_before_the_first_frame_is_never_late():
    with Trial() as trial:
        act(trial.clock.acting, "busy", seconds=0.5, every=1)
        began_ns = trial.clock.now()
        trial.plant.send(Stop())
        assert trial.clock.now() - began_ns < SECOND // 2


def events(folder, trial=0):
    lines = (folder / f"truth-{trial:03d}.jsonl").read_text().splitlines()
    return [json.loads(line) for line in lines]


@pytest.mark.slow
def test_each_trial_is_recorded_in_a_file_of_its_own_with_the_states_of_the_guard(tmp_path):
    folder = tmp_path / "new" / "truth"
    with Trial(record=str(folder), spawned=(12,), faults=DOUBLED) as trial:
        trial.plan_s()
    recorded = events(folder, 12)
    assert [event["state"] for event in recorded if event["event"] == "guard"][-1] != ""
    assert any(event["event"] == "fault" for event in recorded)
    assert recorded[-1]["event"] == "end"
    # the lab goes on for a second after our side has ended
    last = max(event["t_ns"] for event in recorded if event["event"] == "command")
    assert recorded[-1]["t_ns"] - last >= SECOND


@pytest.mark.slow
def test_nothing_is_recorded_without_a_folder_or_before_the_first_trial(tmp_path):
    with Trial(record=None) as trial:
        trial.plan_s()
    with Trial(record=str(tmp_path), spawned=()) as trial:
        trial.plan_s()
    assert list(tmp_path.iterdir()) == []


def test_a_signal_and_an_emergency_stop_reach_the_supervision_of_the_trial():
    signals = []
    supervision = LabSupervision(signalled=lambda: signals.append(1))
    faults = {"about": "x", "faults": [{"fault": "signal", "signal": "INT", "since": "start"}]}
    made = section(faults=faults)
    clock = made.clock()
    rig = made.rig(EXPERIMENT.setup, clock, np.random.SeedSequence(1), supervision)
    clock.sleep_until(SECOND // 10)
    assert signals == [1]
    assert made.rig(EXPERIMENT.setup, made.clock(), np.random.SeedSequence(1)) is not rig


@pytest.mark.parametrize("real", ["camera", "actuator"])
def test_devices_that_are_one_cannot_be_real_and_emulated_one_by_one(real):
    pytest.importorskip("cv2")
    dish = select_plant(load_spec(EXAMPLES / "tetrahymena_dish.yaml"), "emulated").experiment
    made = dish.plant.model_copy(update={"real": real})
    with pytest.raises(AbortError, match="cannot be real while the other is emulated"):
        made.rig(dish.setup, LabClock(), np.random.SeedSequence(1))
