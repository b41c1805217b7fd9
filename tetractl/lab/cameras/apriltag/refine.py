"""Corners of tags, refined: each side of the black square is fitted by a line where the grey level
changes most, and neighbouring lines are intersected.

A side has many pixels and a corner few: corners come out several times better than by OpenCV's own
refinements (benchmarks/apriltag.py).
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from tetractl.core.poses import Floats

ALONG = np.linspace(0.15, 0.85, 15)  # places on a side, away from the corners that blur rounds
ACROSS = np.linspace(-1.0, 1.0, 17)  # places on its normal, in shares of the reach
REACH = 0.9  # modules to either side: beyond lie the tag's inside and what is round the paper
ROUNDS = 2
NOTHING = 1e-9


def refined(picture: NDArray[np.uint8], corners: Floats, modules: int) -> tuple[Floats, Floats]:
    """Return corners (T, 4, 2) [px], refined from rough ones, and the blur of each tag (T,) [px].

    Corners run clockwise round a dark square of so many modules a side. The blur is the standard
    deviation of the Gaussian that makes a step as wide as the sides are. Where the sides cannot be
    seen, the rough corners come back.
    """
    rough, blur = corners, np.zeros(len(corners))
    module = np.linalg.norm(rough - np.roll(rough, -1, axis=1), axis=-1).mean(axis=1) / modules
    offsets = REACH * module[:, None] * ACROSS  # (T, A)
    step = offsets[:, 1:] - offsets[:, :-1]
    between = (offsets[:, 1:] + offsets[:, :-1])[:, None, None] / 2
    for _ in range(ROUNDS):
        side = np.roll(corners, -1, axis=1) - corners
        along = side / (np.linalg.norm(side, axis=-1, keepdims=True) + NOTHING)
        outward = np.stack([along[..., 1], -along[..., 0]], axis=-1)
        places = corners[..., None, :] + ALONG[:, None] * side[..., None, :]  # (T, 4, S, 2)
        normals = outward[:, :, None, None] * offsets[:, None, None, :, None]
        grey = _sampled(picture, places[..., None, :] + normals)
        rise = np.maximum(np.diff(grey, axis=-1), 0.0)  # outward, black turns to white
        weight = rise**2 + NOTHING
        total = weight.sum(axis=-1)
        shift = (weight * between).sum(axis=-1) / total
        lines = _lines(places + shift[..., None] * outward[..., None, :], total)
        corners = _crossings(np.roll(lines, 1, axis=1), lines)
        profile = rise.mean(axis=(1, 2)) / step  # grey levels a pixel
        contrast = (profile * step).sum(axis=-1)
        blur = contrast / (profile.max(axis=-1) + NOTHING) / np.sqrt(2 * np.pi)
    moved = np.linalg.norm(corners - rough, axis=-1).max(axis=1)
    good = moved < 2 * module  # false for NaN too
    return np.where(good[:, None, None], corners, rough), blur


def _sampled(picture: NDArray[np.uint8], at: Floats) -> Floats:
    """Return the grey levels at pixels (..., M, 2), interpolated."""
    flat = at.reshape(-1, at.shape[-2], 2).astype(np.float32)
    across, down = flat[..., 0].copy(), flat[..., 1].copy()
    grey = cv2.remap(picture, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return grey.reshape(at.shape[:-1]).astype(float)


def _lines(points: Floats, weight: Floats) -> Floats:
    """Fit lines a x + b y + c = 0, a^2 + b^2 = 1, to points (..., S, 2); return (..., 3)."""
    share = (weight / weight.sum(axis=-1, keepdims=True))[..., None]
    middle = (share * points).sum(axis=-2)
    spread = points - middle[..., None, :]
    _, axes = np.linalg.eigh(np.swapaxes(share * spread, -1, -2) @ spread)
    normal = axes[..., 0]  # of the smaller eigenvalue
    return np.concatenate([normal, -(normal * middle).sum(axis=-1, keepdims=True)], axis=-1)


def _crossings(one: Floats, other: Floats) -> Floats:
    """Return where lines (..., 3) cross, (..., 2); not finite where they are parallel."""
    meet = np.cross(one, other)
    with np.errstate(divide="ignore", invalid="ignore"):
        return meet[..., :2] / meet[..., 2:]
