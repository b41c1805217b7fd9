"""An arena of 1.6 x 1.8 m with three robots under an emulated camera, and errors of its poses."""

import math
from dataclasses import replace

import numpy as np
from tetractl_emulator.pictures.apriltag.side import Optics, Renderer
from tetractl_microscope.apriltag.camera import Tracker
from tetractl_microscope.apriltag.section import AprilTagSection, FloorTag, RobotTag

from testkit.microscope.needs_opencv import cv2, stack, video
from tetractl.core.poses import Poses

MM = 1e-3
NAMES = ("green", "blue", "red")
ROBOTS = (
    RobotTag(name="green", tag=0, size_mm=80, height_mm=90),
    RobotTag(name="blue", tag=7, size_mm=80, height_mm=90, heading_offset=0.5),
    RobotTag(name="red", tag=586, size_mm=80, height_mm=60),
)
FLOOR = (
    FloorTag(tag=100, at=(400, 250), size_mm=120),
    FloorTag(tag=101, at=(2200, 250), size_mm=120, heading=math.pi / 2),
    FloorTag(tag=102, at=(2200, 2250), size_mm=120),
    FloorTag(tag=103, at=(400, 2250), size_mm=120),
)
SMALL = (640, 480)
LARGE = (1280, 720)
STANDING = Poses(
    np.array([900.0, 1300.0, 1700.0]), np.array([800.0, 1500.0, 2000.0]), np.array([0.3, -2.0, 3.0])
)


def section(source=None, **changes):
    source = source or {"type": "file", "path": "no.avi"}
    return AprilTagSection(
        type="apriltag", source=source, **{"robots": ROBOTS, "floor": FLOOR, **changes}
    )


def rendered(size=SMALL, seed=0, facing=None, **optics):
    facing_floor = Optics.facing(FLOOR, MM, *size, **(facing or {}))
    return Renderer(ROBOTS, FLOOR, MM, replace(facing_floor, **optics), seed)


def tracker(**changes):
    return Tracker(section(**changes), NAMES, MM)


def look(tracker, renderer, poses=STANDING, times=1):
    """See some pictures of standing robots; return what the last one shows."""
    for _ in range(times):
        looked = tracker.track_image(renderer.picture(lambda t_ns: poses, 0))
    return looked


def scattered(rng):
    """Random poses in the arena, robots apart."""
    while True:
        x = rng.uniform(500, 2100, 3)
        y = rng.uniform(350, 2150, 3)
        gaps = np.hypot(x - np.roll(x, 1), y - np.roll(y, 1))
        if gaps.min() > 150:
            return Poses(x, y, rng.uniform(-math.pi, math.pi, 3))


def errors(tracker, renderer, pictures, seed=0):
    """Return errors in mm and in rad over random poses, and the share that was not tracked."""
    rng = np.random.default_rng(seed)
    off = []
    turned = []
    lost = 0
    for _ in range(pictures):
        truth = scattered(rng)
        for i, pose in enumerate(look(tracker, renderer, truth).poses):
            if pose is None:
                lost += 1
                continue
            off.append(math.hypot(pose.x - truth.x[i], pose.y - truth.y[i]))
            turned.append(abs(math.remainder(pose.heading - truth.heading[i], math.tau)))
    return np.array(off), np.array(turned), lost / (3 * pictures)


def jpeg(picture, restarts=0):
    """Return a JPEG file, with a restart marker after every so many blocks."""
    how = [cv2.IMWRITE_JPEG_QUALITY, 90, cv2.IMWRITE_JPEG_RST_INTERVAL, restarts]
    return cv2.imencode(".jpg", picture, how)[1].tobytes()


def film(path, pictures, rate=30.0):
    """Write a video, or a TIFF file, which does not state its rate."""
    if path.suffix == ".tif":
        return {"type": "file", "path": str(stack(path, pictures)), "rate": rate}
    return {"type": "file", "path": str(video(path, pictures, rate))}
