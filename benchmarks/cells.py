"""How well cells are found, followed and distinguished in synthetic films.

    python benchmarks/cells.py films       position, axis, heading, F1, wrong identities, ms
    python benchmarks/cells.py identity    identities after a full merge, by the difference of a
    python benchmarks/cells.py intervals   how often 95 % intervals of `tetractl track` hold
    python benchmarks/cells.py time        ms a picture of 1024 and of 2048 px
    python benchmarks/cells.py log         MB/s of a log with crops, share of its changes noticed

Every picture is synthetic, by `tetractl.emulate.dish`, which the same hands wrote. Seeds from 9000
on are those of the published figures; smaller ones were used in development. --count says how many
films, pairs of cells or changes; --seconds how long each film is.
"""

import argparse
import math
import random
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
from scipy.stats import beta

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from support.dish_films import Reel, Score, record, who
from support.film_logs import write_film
from support.synthetic_film import FilmScript, SyntheticFilm
from support.tampering import noticed, tamperings

from tetractl.emulate.dish.picture import PictureLook
from tetractl.film.fit_cell import summarise
from tetractl.film.follow import follow
from tetractl.lab.cameras.cells.helix import HelixFilter
from tetractl.lab.cameras.cells.identity import opened
from tetractl.lab.cameras.cells.tracking import CellTracker
from tetractl.log.format import channels
from tetractl.log.read.salvage import scan
from tetractl.model.swimmers import Swimmers, bodies

FIRST_SEED = 9000
STEP_S = 1 / 240


def share(hits: int, count: int) -> str:
    """A share with its interval after Clopper and Pearson."""
    low = beta.ppf(0.025, hits, count - hits + 1) if hits else 0.0
    high = beta.ppf(0.975, hits + 1, count - hits) if hits < count else 1.0
    return f"{hits}/{count} = {hits / max(count, 1):.4f} [{low:.4f}, {high:.4f}]"


def film(
    seed: int, seconds: float, side: int, um_px: float | None, **script: object
) -> SyntheticFilm:
    look = PictureLook.drawn(np.random.default_rng(seed), side, um_px)
    return SyntheticFilm(FilmScript(seconds=seconds, **script), look, seed)


def films(count: int, seconds: float) -> None:
    """Once with as many crossings as the bar has, and once with six times as many."""
    for crossings in (1.0, 6.0):
        films_of(count, seconds, crossings)


def films_of(count: int, seconds: float, crossings: float) -> None:
    score, times = Score(), []
    for seed in range(FIRST_SEED, FIRST_SEED + count):
        made = film(seed, seconds, 1024, 2.3, strangers=seed % 11, crossings=crossings)
        score.add(made, follow(reel := Reel(made), made.look.um_px, record(made)))
        times += timed(made, reel)
        print(f"seed {seed}: F1 {score.f1:.4f}, {len(score.changed)} wrong so far", flush=True)

    def rms(values: list) -> float:
        return float(np.sqrt(np.mean(np.square(values))))

    quiet = float(np.quantile(np.abs(score.axis), 0.95))
    print(f"{count} synthetic films of {seconds:g} s, 20 cells and 0 to 10 strangers, 2.3 um/px")
    print(f"each pair of cells is made to cross {crossings:g} times a minute")
    print(f"position RMSE {rms(score.position):.2f} um a coordinate, n {len(score.position)}")
    print(f"axis RMSE {rms(score.axis):.3f} rad, 95 % within {quiet:.3f}")
    middle = np.median(np.abs(score.heading))
    print(f"heading of the helix RMSE {rms(score.heading):.3f} rad, median {middle:.3f}")
    print(f"F1 {score.f1:.4f}: {score.found} found, {score.missed} not, {score.extra} extra")
    hours, stated = score.found / made.script.rate / 3600, np.round(score.changed, 2).tolist()
    print(f"changed numbers {len(stated)} in {hours:.3f} cell-hours; stated {stated}")
    stated = np.round(score.taken, 2).tolist()
    print(f"numbers that were another cell's {len(stated)}; stated {stated}")
    p50, p99 = np.quantile(times, (0.5, 0.99))
    print(f"picture to pose: median {p50:.1f}, p99 {p99:.1f} ms of CPU")


def timed(made: SyntheticFilm, reel: Reel, jpeg: bool = False) -> list[float]:
    """CPU time of one thread a picture [ms], as a live camera has it."""
    tracker = CellTracker(made.look.um_px, known=True)
    tracker.learn(reel.pictures[:: max(1, len(reel.pictures) // 20)])
    field, found = record(made), []
    for t, picture in zip(made.times, reel.pictures, strict=True):
        data = cv2.imencode(".jpg", picture)[1] if jpeg else None
        began = time.thread_time()
        shot = picture if data is None else cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
        tracker.see(shot, float(t), field.pieces)
        found.append(1e3 * (time.thread_time() - began))
    return found


def times(count: int, seconds: float) -> None:
    for side in (1024, 2048):
        plain, coded = [], []
        for seed in range(FIRST_SEED, FIRST_SEED + count):
            made = film(seed, seconds, side, 2.3)
            reel = Reel(made)
            plain += timed(made, reel)
            coded += timed(made, reel, jpeg=True)
        for name, values in (("grey", plain), ("JPEG", coded)):
            p50, p99 = np.quantile(values, (0.5, 0.99))
            print(f"{side} px, {name}: median {p50:.1f}, p99 {p99:.1f} ms of CPU, n {len(values)}")


def identity(count: int, seconds: float) -> None:
    """Two cells leave a full merge at one place and heading, alike but for a; blobs of usual noise.

    Before the merge each is followed for 10 s by itself. The field changes every 0.3 to 1.2 s.
    """
    for apart, limit in ((0.3, 1.5), (0.15, 3.0), (0.05, 3.0)):
        right = sure_wrong = sure = 0
        for pair in range(count):
            order, probability = after_merge(FIRST_SEED + pair, apart, limit)
            right += order == (0, 1)
            if probability > 0.9:
                sure += 1
                sure_wrong += order != (0, 1)
        wrong = share(sure_wrong, max(sure, 1))
        print(
            f"a apart by {100 * apart:g} %, {limit:g} s after a full merge: right "
            f"{share(right, count)}; stated above 0.9 in {sure}, wrong in {wrong}"
        )


def after_merge(seed: int, apart: float, limit: float) -> tuple[tuple[int, ...], float]:
    """The likeliest order of two cells and its probability, `limit` seconds after their merge."""
    random = np.random.default_rng(seed)
    cells = Swimmers.drawn(random, 2)
    a = random.uniform(3.0, 5.0)
    cells.a[:] = a * (1 + apart / 2), a * (1 - apart / 2)
    for name in ("speed", "length", "width", "helix_um", "helix_hz", "bias", "phase", "heading"):
        getattr(cells, name)[1] = getattr(cells, name)[0]
    cells.bias[:] = 0.0
    bank, deviation = HelixFilter(True), np.tile((0.86, 0.86, 0.04), (2, 1))
    rows = np.array([bank.add(0.0, 0.0, cells.heading[i], cells.speed[i]) for i in range(2)])
    question, direction, left, frame = None, 0.0, 0.0, 0
    for k in range(round((10.0 + limit) / STEP_S)):
        t = k * STEP_S
        if left <= 0:
            direction, left = random.uniform(-math.pi, math.pi), random.uniform(0.3, 1.2)
        if question is None and t >= 10.0:  # at one place with one heading
            cells.x[:], cells.y[:], cells.heading[1] = 0.0, 0.0, cells.heading[0]
            cells.phase[1] = cells.phase[0]
            bank.mean[rows, :2] = bank.mean[rows[0], :2] - bank.mean[rows[0], :2]
            bank.mean[rows, 2] = cells.heading[0]
            bank.mean[rows[1], 4:6] = bank.mean[rows[0], 4:6]
            alike = np.tile((cells.length[0], cells.width[0]), (2, 1))
            places = bank.mean[rows, :3].copy()
            question = opened(bank, (0, 1), rows.tolist(), places, alike, t)
        field = (math.cos(direction), math.sin(direction))
        cells.swim(field, STEP_S, random)
        bank.predict([(STEP_S, *field)])
        left -= STEP_S
        frame += 1
        if frame % 8:
            continue
        seen = bodies(cells)
        blobs = np.column_stack([seen.x, seen.y, seen.axis])
        blobs += random.normal(0, 1, (2, 3)) * (0.4, 0.4, 0.02)
        if question is None:
            bank.update(rows, blobs, deviation)
        else:
            for track in range(2):
                likelihood, _ = bank.update(
                    question.rows[track], np.tile(blobs[track], (2, 1)), deviation
                )
                question.add(track, likelihood)
    assert question is not None
    return question.best()


def intervals(count: int, seconds: float) -> None:
    inside, found = [], 0
    for seed in range(FIRST_SEED, FIRST_SEED + count):
        made = film(seed, seconds, 768, 3.0, cells=12, strangers=1, events=False)
        seen = follow(Reel(made), made.look.um_px, record(made))
        for path, cell in zip(seen.paths, summarise(seen, record(made)), strict=True):
            i = who(made, path)
            if i is None or cell.a is None or cell.speed is None:
                continue
            found += 1
            truth = made.cells.a[i], made.cells.speed[i]
            inside.append(
                [e.low < v < e.high for e, v in zip((cell.a, cell.speed), truth, strict=True)]
            )
        print(f"seed {seed}: {found} cells, inside {np.mean(inside, axis=0).round(3)}", flush=True)
    a, speed = np.sum(inside, axis=0)
    print(f"{count} synthetic films of {seconds:g} s, cells seen for 2 s or more")
    print(f"95 % interval of a holds: {share(int(a), found)}")
    print(f"95 % interval of the speed holds: {share(int(speed), found)}")


def logs(count: int, seconds: float) -> None:
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(FIRST_SEED, FIRST_SEED + 3):
            path = Path(folder) / f"{seed}.mcap"
            made = film(seed, seconds, 1024, 2.3)
            samples = write_film(made, path, robots=3)
            crops = np.mean([len(sample.film.crops) for sample in samples])
            rate = path.stat().st_size * made.script.rate / len(samples) / 1e6
            print(f"seed {seed}: {rate:.2f} MB/s, {crops:.1f} crops a picture", flush=True)
        log = scan(path)
        shown = (*channels.FILM, channels.FRAMES, channels.TRANSFORMS)
        random.seed(FIRST_SEED)
        tried = random.sample([one for one in tamperings(log, 60) if one.channel in shown], count)
        seen = [noticed(log, one, Path(folder) / "changed.mcap") for one in tried]
    print(f"changed crops, poses and what is said of them, noticed: {share(sum(seen), count)}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("part", choices=("films", "identity", "intervals", "time", "log"))
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=10.0)
    chosen = parser.parse_args()
    cv2.setNumThreads(1)
    parts = {
        "films": films,
        "identity": identity,
        "intervals": intervals,
        "time": times,
        "log": logs,
    }
    parts[chosen.part](chosen.count, chosen.seconds)
