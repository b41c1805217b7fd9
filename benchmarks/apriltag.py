"""Measures the accuracy of the AprilTag camera: `python benchmarks/apriltag.py [PART]...`.

    poses       error against the emulated truth, 640x480 and 1280x720
    corners     error of corners refined by us and by OpenCV
    tilt        extra error without a known focal length, the straighter down the camera looks
    blur        fraction of tags found as the lens blurs

By default, all parts run. The output is the figures of
packages/tetractl-microscope/docs/apriltag.md. The arena is 1.6 x 1.8 m. It has three robots with
tags of 80 mm at 90 mm above the floor, and four floor tags of 120 mm at its corners. The camera
looks at it from the side, 20 degrees from the vertical, through a lens of 63 degrees. `--scale 0.1`
does a tenth of the work.
"""

import argparse
import math
import os
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from testkit.microscope.tag_scene import FLOOR, MM, NAMES, scattered
from tetractl_emulator.pictures.apriltag.side import CARD, Optics, Renderer
from tetractl_microscope.apriltag.camera import Tracker
from tetractl_microscope.apriltag.detect import MODULES, refined
from tetractl_microscope.apriltag.section import AprilTagSection, RobotTag

from tetractl.core.poses import Grey, Poses

ROBOTS = tuple(
    RobotTag(name=name, tag=tag, size_mm=80, height_mm=90) for tag, name in enumerate(NAMES)
)
SIZES = ((640, 480), (1280, 720))
BENT = (-0.2, 0.08, 0.002, -0.002, 0.0)
QUALITY = 90


def section(source: dict[str, object] | None = None, **changes: object) -> AprilTagSection:
    source = source or {"type": "file", "path": "none"}
    camera = {"type": "apriltag", "source": source, "robots": ROBOTS, "floor": FLOOR}
    return AprilTagSection.model_validate({**camera, **changes})


def renderer(size: tuple[int, int], tilt: float = 0.35, **optics: object) -> Renderer:
    facing = Optics.facing(FLOOR, MM, *size, tilt=tilt)
    return Renderer(ROBOTS, FLOOR, MM, replace(facing, **optics), seed=1)


def sent(picture: Grey) -> Grey:
    """Return an image after JPEG compression."""
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return cv2.imdecode(data, cv2.IMREAD_GRAYSCALE).astype(np.uint8)


def row(*cells: object) -> None:
    print("| " + " | ".join(str(cell) for cell in cells) + " |", flush=True)


def table(*titles: str) -> None:
    row(*titles)
    row(*("--:" for _ in titles))


def errors(
    tracker: Tracker, drawn: Renderer, pictures: int, moving: bool = False
) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Measure pose errors [mm] and [mrad], the fraction of robots found, and the smallest tag."""
    rng = np.random.default_rng(2)
    off = []
    turned = []
    small = math.inf
    for _ in range(pictures):
        poses = scattered(rng)
        way = rng.uniform(-math.pi, math.pi, 3)
        turn = rng.uniform(-3, 3, 3)

        def at(t_ns: int, poses=poses, way=way, turn=turn) -> Poses:
            t = 1e-9 * t_ns * moving
            x = poses.x + 200 * t * np.cos(way)
            y = poses.y + 200 * t * np.sin(way)
            return Poses(x, y, poses.heading + turn * t)

        tracked = tracker.see(sent(drawn.picture(at, 0)))
        small = min(small, tracked.side_px or math.inf)
        for i, pose in enumerate(tracked.poses):
            if pose is not None:
                off.append(math.hypot(pose.x - poses.x[i], pose.y - poses.y[i]))
                turned.append(abs(math.remainder(pose.heading - poses.heading[i], math.tau)))
    return np.array(off), 1e3 * np.array(turned), len(off) / (3 * pictures), small


def poses(scale: float) -> None:
    """Print errors of poses under several conditions."""
    table("picture", "case", "found", "mm, 95 %", "mrad, 95 %", "tag px")
    for size in SIZES:
        bent = renderer(size, distortion=BENT)
        simple = renderer(size, distortion=(-0.2, 0.0, 0.0, 0.0))
        lens = {"focal_px": bent.optics.focal_px, "distortion": BENT}
        cases: list[tuple[str, Renderer, dict[str, object], bool]] = [
            ("standing", renderer(size), {}, False),
            ("200 mm/s and 3 rad/s, 15 ms exposure", renderer(size, exposure_s=0.015), {}, True),
            ("lens with distortion k1 = -0.2", simple, {}, False),
            ("lens with k1, k2, p1, p2, given", bent, {"lens": lens}, False),
            ("the same, not given", bent, {}, False),
            ("height_mm: 0 for tags at 90", renderer(size), {"robots": low()}, False),
        ]
        for name, drawn, changes, moving in cases:
            tracker = Tracker(section(**changes), NAMES, MM)
            mm, mrad, share, small = errors(tracker, drawn, round(300 * scale), moving)
            errors_95 = f"{np.quantile(mm, 0.95):.2f}", f"{np.quantile(mrad, 0.95):.1f}"
            row(told(size), name, f"{100 * share:.1f} %", *errors_95, f"{small:.0f}")


def low() -> list[RobotTag]:
    return [robot.model_copy(update={"height_mm": 0.0}) for robot in ROBOTS]


def told(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"


def corners(scale: float) -> None:
    """Print errors of corners by several methods against the truth."""
    table("picture", "corners by", "error, rms px")
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    for size in SIZES:
        drawn = renderer(size)
        rng = np.random.default_rng(3)
        shots = []
        for _ in range(round(60 * scale)):
            poses = scattered(rng)
            shots.append((poses, drawn.picture(partial(stand, poses), 0)))
        for name in ("NONE", "CONTOUR", "SUBPIX", "APRILTAG", "sides"):
            parameters = cv2.aruco.DetectorParameters()
            parameters.cornerRefinementMethod = getattr(
                cv2.aruco, f"CORNER_REFINE_{name}", cv2.aruco.CORNER_REFINE_NONE
            )
            detector = cv2.aruco.ArucoDetector(family, parameters)
            off = []
            for truth, picture in shots:
                rough, numbers, _ = detector.detectMarkers(picture)
                places = np.array(rough, float).reshape(-1, 4, 2)
                if name == "sides":
                    places, _ = refined(picture, places, MODULES)
                for tag, place in zip(np.ravel(numbers), places, strict=True):
                    if tag < len(ROBOTS):
                        card = drawn.card(ROBOTS[tag], truth, tag)
                        square = card.mean(axis=0) + (card - card.mean(axis=0)) * MODULES / CARD
                        gaps = [np.roll(place, k, axis=0) - square for k in range(4)]
                        squares = [np.square(gap).sum() for gap in gaps]
                        off.append(gaps[int(np.argmin(squares))])
            way = "sides" if name == "sides" else f"OpenCV, {name}"
            rms = math.sqrt(np.mean(np.square(off)))
            row(told(size), way, f"{rms:.3f}")


def tilt(scale: float) -> None:
    """Print pose errors and their estimated uncertainty by camera tilt, with and without a known
    lens.
    """
    table("picture", "tilt, rad", "mm, median", "doubt_mm", "with the focal length: mm, median")
    for size in SIZES:
        for angle in (0.0, 0.1, 0.2):
            drawn = renderer(size, tilt=angle)
            blind = Tracker(section(), NAMES, MM)
            tracker = Tracker(section(lens={"focal_px": drawn.optics.focal_px}), NAMES, MM)
            mm, _, _, _ = errors(blind, drawn, round(100 * scale))
            right, _, _, _ = errors(tracker, drawn, round(100 * scale))
            values = np.median(mm), blind.floor.plane.doubt_mm, np.median(right)
            row(told(size), angle, *(f"{value:.2f}" for value in values))


def blur(scale: float) -> None:
    """Print the fraction of robots found by blur of the lens."""
    table("picture", "blur, px", "found")
    for size in SIZES:
        for sigma in (0.9, 1.1, 1.5):
            tracker = Tracker(section(), NAMES, MM)
            poses = scattered(np.random.default_rng(0))
            for _ in range(2):
                picture = renderer(size).picture(partial(stand, poses), 0)
                tracker.see(picture)
            _, _, share, _ = errors(tracker, renderer(size, blur_px=sigma), round(100 * scale))
            row(told(size), sigma, f"{100 * share:.1f} %")


def stand(poses: Poses, t_ns: int) -> Poses:
    return poses


PARTS = {part.__name__: part for part in (poses, corners, tilt, blur)}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("parts", nargs="*", choices=[[], *PARTS], metavar="PART")
    parser.add_argument("--scale", type=float, default=1.0)
    chosen = parser.parse_args()
    print(f"{os.cpu_count()} cores, OpenCV {cv2.__version__}")
    for name in chosen.parts or PARTS:
        print(f"\n### {name} (load {os.getloadavg()[0]:.1f} before)\n")
        PARTS[name](chosen.scale)


if __name__ == "__main__":
    main()
