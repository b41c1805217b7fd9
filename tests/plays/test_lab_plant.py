"""What `tetractl.core.protocols.Plant` promises, kept by the lab's plant over its whole wires."""

import numpy as np
import pytest
from support.lab_processes import SPEC
from support.virtual_play import virtual_lab

from tetractl.core.clock import SECOND
from tetractl.core.commands import Command
from tetractl.core.errors import AbortError
from tetractl.core.protocols import LabSupervision
from tetractl.experiment.load import load_spec
from tetractl.experiment.plants import on_plant
from tetractl.log.read.trial_log import Origin
from tetractl.plant.lab_plant import LabPlant

DIRECTIONS = (0.5, -0.4, 0.6)
PERIOD = SECOND // 5


@pytest.fixture
def make(tmp_path):
    made = []
    with virtual_lab(tmp_path) as lab:

        def plant(*sets, supervision=None):
            experiment = on_plant(load_spec(SPEC, (*lab.settings, *sets)), "lab").experiment
            clock = experiment.plant.clock()
            seed = np.random.SeedSequence(1)
            supervision = supervision or LabSupervision()
            made.append(experiment.plant.build(experiment.setup, clock, seed, supervision))
            return made[-1], clock, experiment

        yield plant
        for each in made:
            each.stop()
            each.close()


def test_one_run_keeps_every_promise(make):
    plant, clock, experiment = make()
    assert isinstance(plant, LabPlant)
    count = len(experiment.robots)
    info = plant.open()
    assert (info.kind, info.simulated) == ("lab", False)
    assert 100 < info.camera_rate_hz < 140
    assert all(isinstance(value, str) for value in info.facts.values())
    assert info.facts["emulated"] == "camera"
    assert Origin.of(experiment, info) is Origin.EMULATED

    first = plant.observe()
    starts = np.array([robot.start for robot in experiment.robots])
    assert np.abs(first.poses.xy - starts).max() < 50
    began = clock.now()
    seen, commands, samples, news = [first], [], [], []
    for k, direction in enumerate(DIRECTIONS, start=1):
        commands.append(plant.steer(direction))
        samples += plant.samples()
        news += plant.news()
        clock.sleep_until(began + k * PERIOD)
        seen.append(plant.observe())
        assert seen[-1].sampled_ns <= seen[-1].received_ns <= clock.now()
    stop = plant.stop()
    assert plant.stop() is stop
    verdict = plant.settle()
    samples += plant.samples()
    news += plant.news()

    frames = [sample.observation.frame for sample in samples]
    assert frames == sorted(set(frames))
    by_frame = {sample.observation.frame: sample.observation for sample in samples}
    for observation in seen:
        assert by_frame[observation.frame] is observation
    assert [command.direction for command in commands] == list(DIRECTIONS)
    others = [item for item in news if isinstance(item, Command)]
    told = sorted((*commands, *others), key=lambda command: command.sent_ns)
    assert len({command.sent_ns for command in told}) == len(told), "each is sent once"
    assert len(others) > len(commands), "the inner loop sends between the control steps"
    for command in told:
        assert command.left.shape == command.right.shape == (count,)
        assert len(command.delivered) == count
    assert stop.direction is None
    assert not stop.left.any()
    stops = [command for command in others if command.direction is None]
    assert len(stops) >= 10
    assert verdict.not_at_rest == ""
    last = samples[-1].observation.poses
    assert np.abs(last.array() - verdict.final.array()).max() < 0.5
    assert np.hypot(*(verdict.final.xy - starts).T).max() > 30
    assert verdict.entered == (False,) * count
    assert all(clearance > 0 for clearance in verdict.clearance)
    plant.close()
    plant.close()
    plant.stop()


def test_a_port_that_is_not_there_refuses(make, tmp_path):
    plant, _, _ = make(f"lab.actuator.port={tmp_path}/none")
    with pytest.raises(AbortError, match="there is no such port"):
        plant.open()
