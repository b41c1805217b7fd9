"""Logs with a synthetic film of a dish: frames and images, but no control steps."""

from dataclasses import replace

import numpy as np
from tetractl_microscope.cells.camera import CellCamera

from testkit.microscope.needs_opencv import cv2
from testkit.recorder import Recorder
from tetractl.core.clock import VirtualClock
from tetractl.core.commands import Command, Stop
from tetractl.core.plan import Outcome
from tetractl.core.poses import Observation, Poses, Sample
from tetractl.core.route_measure import RouteMeasure
from tetractl.core.trial import PlantInfo, Result
from tetractl.log.read.reader import trial_path
from tetractl.log.write.writer import LogWriter
from tetractl.model.path_check import check_path
from tetractl.spec.load import parse_spec
from tetractl.spec.loaded_spec import create_start
from tetractl.spec.plants import select_plant

SPEC = """
name: dish
units: {{length: um}}
arena: {{left: -1000, bottom: -1000, width: 9000, height: 9000}}
robots: {robots}
lab:
  camera: {{type: cells, source: {{type: file, path: film.avi}}, um_px: {um_px}, learning: 0.5}}
  actuator:
    type: field
    port: nowhere
    strength_mt: 2.0
    coils: {{x: {{gain_mt_a: 2, offset_mt: 0}}, y: {{gain_mt_a: 2, offset_mt: 0}}, rotation: 0}}
    current_max_a: 2.0
    slew_max_a_s: 100
"""


def samples_of(synthetic, robots: int):
    """The loaded spec, and what its camera makes of a film: samples with pictures."""
    starts = synthetic.body[20, :robots, :2]
    listed = [
        f"{{name: c{i}, start: [{x:.1f}, {y:.1f}], target: [600, 600], a: 4, speed: 300}}"
        for i, (x, y) in enumerate(np.nan_to_num(starts, nan=500.0))
    ]
    text = SPEC.format(robots="[" + ", ".join(listed) + "]", um_px=synthetic.look.um_px)
    loaded = select_plant(parse_spec(text, "dish.yaml"), "lab")
    setup = loaded.experiment.setup
    camera = CellCamera(loaded.experiment.plant.camera, setup, VirtualClock())
    last = setup.starts.array()
    gathered = []
    for k, picture in enumerate(synthetic.pictures()):
        exposed = round(1e9 * k / synthetic.script.rate)
        looked = camera._see(picture, exposed)
        if looked is None:
            continue
        (added,) = camera.additions()
        valid = np.array([pose is not None for pose in looked.poses])
        for i, pose in enumerate(looked.poses):
            if pose is not None:
                last[i] = pose.x, pose.y, pose.heading
        poses = Poses.from_array(last.copy())
        observation = Observation(k, exposed, exposed + 9_000_000, poses, valid)
        gathered.append(Sample(observation, None, added.messages))
    return loaded, gathered


def write_film(synthetic, path, robots: int = 2):
    """Write a log of a film; return the samples in it."""
    loaded, samples = samples_of(synthetic, robots)
    look = synthetic.look
    facts = {"opencv": cv2.__version__, "resolution": f"{look.width}x{look.height}", "halts": "no"}
    info = PlantInfo("lab", False, float(synthetic.script.rate), facts)
    start = create_start(loaded, 0, info, 1_790_000_000_123_456_789)
    stop = Command(Stop(), samples[-1].observation.received_ns, (True,) * robots)
    recorder = Recorder()
    with LogWriter(path) as writer:
        for observer in (writer, recorder):
            observer.on_start(start)
            observer.on_samples(samples)
        setup = start.setup
        log = replace(recorder.trial, commands=(stop,))
        track, were_seen = trial_path(log)
        result = Result.from_verdict(
            setup,
            check_path(setup, track, were_seen, samples[-1].observation.poses),
            outcome=Outcome.INTERRUPTED,
            reason="interrupted before the first step",
            duration_s=stop.sent_ns / 1e9 - samples[0].observation.received_ns / 1e9,
            solve_ns=(),
            deadline_misses=0,
            route=RouteMeasure(setup.legs, None, None, setup.speed),
        )
        writer.on_stop(stop, result)
    return samples
