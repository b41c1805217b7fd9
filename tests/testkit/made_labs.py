"""A made-up lab trial in which one robot drives and another may be lost."""

from dataclasses import replace

import numpy as np

from testkit import random_trials
from testkit.paths import ROOT
from tetractl.core.plan import Outcome
from tetractl.core.trial import HALTS_FACT, PlantInfo
from tetractl.spec.load import load_spec
from tetractl.spec.plants import select_plant


def lab_log(tmp_path, valid, speed_mm, halts, metres):
    """A complete lab trial: a second of frames at 100 Hz; robot 0 drives along x throughout."""
    random_trial = random_trials.trial(simulated=False)
    log = random_trials.write_and_read(random_trial, tmp_path / "trial.mcap")
    lab = select_plant(load_spec(ROOT / "experiments" / "three_m3pi_lab.yaml"), "lab").experiment
    poses = np.zeros((100, 3, 3))
    poses[:, 0, 0] = np.arange(100) * speed_mm / 100 * 0.001 / metres
    setup = replace(lab.setup, metres=metres)
    return replace(
        log,
        experiment=lab,
        start=replace(
            log.start, setup=setup, plant=PlantInfo("lab", False, 100.0, {HALTS_FACT: halts})
        ),
        result=replace(log.result, outcome=Outcome.ARRIVED),
        notes=(),
        damage=None,
        mocap=poses,
        valid=valid,
        frames=np.arange(100),
        mocap_ns=np.arange(100) * 10_000_000,
        received_ns=np.arange(100) * 10_000_000 + 1,
        exposed_ns=np.arange(100)[:, None].repeat(3, axis=1) * 10_000_000,
    )


def lost(robot, since, until=100):
    valid = np.ones((100, 3), bool)
    valid[since:until, robot] = False
    return valid
