"""trackpy and laptrack on plain detections: median background, threshold, connected components.

Both are tuned as a user would, on films of seeds 1 and 2: how far a cell swims between pictures,
how long it may be missed, how large it is; what does not move away from where it began is dropped.
"""

import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from .scores import Shown

BACKGROUND = 41  # pictures
BLUR_PX = 1.2
SIGMAS = 5.0  # threshold over the robust noise of the blurred difference
AREA_UM2 = 250.0, 6000.0  # of a detection
RANGE_UM = 32.0  # way between two pictures: 960 um/s at 30 Hz
MISSED = 2  # pictures for which a cell may be missed
SHORTEST = 15  # least pictures of a track that counts
MOVED_UM = 80.0  # least way of one


@cache
def detections(film: Path, um_px: float) -> pd.DataFrame:
    """Return frame, x, y (down) [px] of what differs from the film's median."""
    pictures = []
    reader = cv2.VideoCapture(str(film))
    there_is_one, picture = reader.read()
    while there_is_one:
        pictures.append(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY))
        there_is_one, picture = reader.read()
    light = np.array([np.median(picture[::8, ::8]) for picture in pictures])
    step = max(1, len(pictures) // BACKGROUND)
    scaled = [pictures[k] * np.float32(light[0] / light[k]) for k in range(0, len(pictures), step)]
    background = cv2.GaussianBlur(np.median(scaled, axis=0).astype(np.float32), (0, 0), BLUR_PX)
    low, high = (area / um_px**2 for area in AREA_UM2)
    rows = []
    for k, picture in enumerate(pictures):
        grey = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), BLUR_PX)
        off = np.abs(grey * np.float32(light[0] / light[k]) - background)
        noise = 1.4826 * np.median(off[::4, ::4])
        mask = (off > SIGMAS * noise).astype(np.uint8)
        mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
        count, _, stats, middles = cv2.connectedComponentsWithStats(mask)
        area = stats[:, cv2.CC_STAT_AREA]
        fit = [i for i in range(1, count) if low <= area[i] <= high]
        rows += [(k, *middles[i]) for i in fit]
    return pd.DataFrame(rows, columns=["frame", "x", "y"])


def trackpy_rows(features: pd.DataFrame, way: float) -> pd.DataFrame:
    """Return the features with the particle of each, which swims up to a `way` [px] a picture."""
    import trackpy

    trackpy.quiet()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        predict = trackpy.predict.NearestVelocityPredict()
        return predict.link_df(
            features, way, memory=MISSED, adaptive_stop=way / 4, adaptive_step=0.9
        )


def laptrack_rows(features: pd.DataFrame, way: float) -> pd.DataFrame:
    """Return the same of laptrack, whose costs are squares of ways."""
    from laptrack import LapTrack

    linker = LapTrack(
        cutoff=way**2,
        gap_closing_cutoff=4 * way**2,
        gap_closing_max_frame_count=MISSED,
        splitting_cutoff=False,
        merging_cutoff=False,
    )
    tracks, _, _ = linker.predict_dataframe(
        features, coordinate_cols=["x", "y"], frame_col="frame", only_coordinate_cols=False
    )
    tracks = tracks.reset_index(drop=True).rename(columns={"track_id": "particle"})
    return tracks if "frame" in tracks else tracks.rename(columns={"frame_y": "frame"})


def _linked(link: Callable[[pd.DataFrame, float], pd.DataFrame], folder: Path, um_px: float):
    features = detections(folder / "film.avi", um_px)
    way = RANGE_UM / um_px
    tracks = link(features.copy(), way) if len(features) else features.assign(particle=[])
    long_tracks = []
    for _, track in tracks.groupby("particle"):
        way = np.hypot(track.x - track.x.iloc[0], track.y - track.y.iloc[0]).max() * um_px
        if len(track) >= SHORTEST and way >= MOVED_UM:
            long_tracks.append(track)
    table = pd.concat(long_tracks).sort_values("frame") if long_tracks else tracks.iloc[:0]
    height = cv2.VideoCapture(str(folder / "film.avi")).get(cv2.CAP_PROP_FRAME_HEIGHT)
    return Shown(
        frame=table.frame.to_numpy(int),
        name=table.particle.to_numpy(int),
        x=(table.x.to_numpy(float) + 0.5) * um_px,
        y=(height - 0.5 - table.y.to_numpy(float)) * um_px,
        heading=np.full(len(table), np.nan),
        sure=np.ones(len(table), bool),
    )


PEERS = {
    "trackpy": lambda folder, um_px: _linked(trackpy_rows, folder, um_px),
    "laptrack": lambda folder, um_px: _linked(laptrack_rows, folder, um_px),
}
