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
from tetractl_microscope.apriltag.detect import MODULES, refine_corners
from tetractl_microscope.apriltag.section import AprilTagSection, RobotTag

from tetractl.core.poses import GreyImage, Poses

ROBOTS = tuple(
    RobotTag(name=name, tag=tag, size_mm=80, height_mm=90) for tag, name in enumerate(NAMES)
)
SIZES = ((640, 480), (1280, 720))
LENS_DISTORTION = (-0.2, 0.08, 0.002, -0.002, 0.0)
JPEG_QUALITY = 90


def make_section(source: dict[str, object] | None = None, **changes: object) -> AprilTagSection:
    source = source or {"type": "file", "path": "none"}
    camera = {"type": "apriltag", "source": source, "robots": ROBOTS, "floor": FLOOR}
    return AprilTagSection.model_validate({**camera, **changes})


def make_renderer(size_px: tuple[int, int], tilt: float = 0.35, **optics: object) -> Renderer:
    optics_of_camera = Optics.facing(FLOOR, MM, *size_px, tilt=tilt)
    return Renderer(ROBOTS, FLOOR, MM, replace(optics_of_camera, **optics), seed=1)


def compressed(picture: GreyImage) -> GreyImage:
    """Return an image after JPEG compression."""
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return cv2.imdecode(data, cv2.IMREAD_GRAYSCALE).astype(np.uint8)


def print_row(*cells: object) -> None:
    print("| " + " | ".join(str(cell) for cell in cells) + " |", flush=True)


def print_header(*titles: str) -> None:
    print_row(*titles)
    print_row(*("--:" for _ in titles))


def measure_errors(
    tracker: Tracker, scene: Renderer, pictures: int, moving: bool = False
) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Measure how accurately a tracker finds the robots in rendered images of random poses.

    Args:
        tracker: The tracker under test.
        scene: Renders the images.
        pictures: Number of images.
        moving: Whether the robots move during the exposure.

    Returns:
        The distance errors [mm] and heading errors [mrad] of the robots found, the fraction of
        robots found, and the side of the smallest tag [px].
    """
    rng = np.random.default_rng(2)
    distances_mm = []
    angles_mrad = []
    smallest_px = math.inf
    for _ in range(pictures):
        poses = scattered(rng)
        directions = rng.uniform(-math.pi, math.pi, 3)
        turning_rates = rng.uniform(-3, 3, 3)

        def at(t_ns: int, poses=poses, directions=directions, turning_rates=turning_rates) -> Poses:
            t_s = 1e-9 * t_ns * moving
            x = poses.x + 200 * t_s * np.cos(directions)
            y = poses.y + 200 * t_s * np.sin(directions)
            return Poses(x, y, poses.heading + turning_rates * t_s)

        tracked = tracker.track_image(compressed(scene.picture(at, 0)))
        smallest_px = min(smallest_px, tracked.side_px or math.inf)
        for i, pose in enumerate(tracked.poses):
            if pose is not None:
                distances_mm.append(math.hypot(pose.x - poses.x[i], pose.y - poses.y[i]))
                angles_mrad.append(abs(math.remainder(pose.heading - poses.heading[i], math.tau)))
    return (
        np.array(distances_mm),
        1e3 * np.array(angles_mrad),
        len(distances_mm) / (3 * pictures),
        smallest_px,
    )


def poses(scale: float) -> None:
    """Print errors of poses under several conditions."""
    print_header("picture", "case", "found", "mm, 95 %", "mrad, 95 %", "tag px")
    for size in SIZES:
        bent = make_renderer(size, distortion=LENS_DISTORTION)
        simple = make_renderer(size, distortion=(-0.2, 0.0, 0.0, 0.0))
        lens = {"focal_px": bent.optics.focal_px, "distortion": LENS_DISTORTION}
        cases: list[tuple[str, Renderer, dict[str, object], bool]] = [
            ("standing", make_renderer(size), {}, False),
            (
                "200 mm/s and 3 rad/s, 15 ms exposure",
                make_renderer(size, exposure_s=0.015),
                {},
                True,
            ),
            ("lens with distortion k1 = -0.2", simple, {}, False),
            ("lens with k1, k2, p1, p2, given", bent, {"lens": lens}, False),
            ("the same, not given", bent, {}, False),
            (
                "height_mm: 0 for tags at 90",
                make_renderer(size),
                {"robots": robots_with_tags_on_floor()},
                False,
            ),
        ]
        for name, scene, changes, moving in cases:
            tracker = Tracker(make_section(**changes), NAMES, MM)
            mm, mrad, found, smallest_px = measure_errors(
                tracker, scene, round(300 * scale), moving
            )
            errors_95 = f"{np.quantile(mm, 0.95):.2f}", f"{np.quantile(mrad, 0.95):.1f}"
            print_row(
                size_text(size), name, f"{100 * found:.1f} %", *errors_95, f"{smallest_px:.0f}"
            )


def robots_with_tags_on_floor() -> list[RobotTag]:
    return [robot.model_copy(update={"height_mm": 0.0}) for robot in ROBOTS]


def size_text(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"


def corners(scale: float) -> None:
    """Print errors of corners by several methods against the truth."""
    print_header("picture", "corners by", "error, rms px")
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    for size in SIZES:
        scene = make_renderer(size)
        rng = np.random.default_rng(3)
        images = []
        for _ in range(round(60 * scale)):
            poses = scattered(rng)
            images.append((poses, scene.picture(partial(stationary_poses, poses), 0)))
        for name in ("NONE", "CONTOUR", "SUBPIX", "APRILTAG", "sides"):
            parameters = cv2.aruco.DetectorParameters()
            parameters.cornerRefinementMethod = getattr(
                cv2.aruco, f"CORNER_REFINE_{name}", cv2.aruco.CORNER_REFINE_NONE
            )
            detector = cv2.aruco.ArucoDetector(family, parameters)
            errors_px = []
            for truth, picture in images:
                rough, tag_ids, _ = detector.detectMarkers(picture)
                corners_px = np.array(rough, float).reshape(-1, 4, 2)
                if name == "sides":
                    corners_px, _ = refine_corners(picture, corners_px, MODULES)
                for tag, tag_corners in zip(np.ravel(tag_ids), corners_px, strict=True):
                    if tag < len(ROBOTS):
                        card = scene.card(ROBOTS[tag], truth, tag)
                        square = card.mean(axis=0) + (card - card.mean(axis=0)) * MODULES / CARD
                        gaps = [np.roll(tag_corners, k, axis=0) - square for k in range(4)]
                        squares = [np.square(gap).sum() for gap in gaps]
                        errors_px.append(gaps[int(np.argmin(squares))])
            method = "sides" if name == "sides" else f"OpenCV, {name}"
            rms = math.sqrt(np.mean(np.square(errors_px)))
            print_row(size_text(size), method, f"{rms:.3f}")


def tilt(scale: float) -> None:
    """Print pose errors and their estimated uncertainty by camera tilt, with and without a known
    lens.
    """
    print_header(
        "picture", "tilt, rad", "mm, median", "doubt_mm", "with the focal length: mm, median"
    )
    for size in SIZES:
        for angle in (0.0, 0.1, 0.2):
            scene = make_renderer(size, tilt=angle)
            without_lens = Tracker(make_section(), NAMES, MM)
            with_lens = Tracker(make_section(lens={"focal_px": scene.optics.focal_px}), NAMES, MM)
            mm, _, _, _ = measure_errors(without_lens, scene, round(100 * scale))
            mm_with_lens, _, _, _ = measure_errors(with_lens, scene, round(100 * scale))
            cells = np.median(mm), without_lens.floor.plane.lens_error_mm, np.median(mm_with_lens)
            print_row(size_text(size), angle, *(f"{value:.2f}" for value in cells))


def blur(scale: float) -> None:
    """Print the fraction of robots found by blur of the lens."""
    print_header("picture", "blur, px", "found")
    for size in SIZES:
        for sigma in (0.9, 1.1, 1.5):
            tracker = Tracker(make_section(), NAMES, MM)
            poses = scattered(np.random.default_rng(0))
            for _ in range(2):
                picture = make_renderer(size).picture(partial(stationary_poses, poses), 0)
                tracker.track_image(picture)
            _, _, found, _ = measure_errors(
                tracker, make_renderer(size, blur_px=sigma), round(100 * scale)
            )
            print_row(size_text(size), sigma, f"{100 * found:.1f} %")


def stationary_poses(poses: Poses, t_ns: int) -> Poses:
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
