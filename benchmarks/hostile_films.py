"""Films made to hang, crash or fill memory, each followed by `tetractl track`.

The films of tests/support/hostile_films.py, made by hand, come first; then, without end, good films
with some bytes changed, with odd shapes and values, and with wrong fields, times and options. The
latter run `track` in one process, which decodes them, too; a film that ends this process is tried
again with a process of its own that decodes it. Prints what came of them, and the peak memory.
"""

import argparse
import faulthandler
import io
import multiprocessing
import random
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from contextlib import redirect_stderr, redirect_stdout
from multiprocessing.connection import Connection
from pathlib import Path
from shutil import rmtree
from typing import Any
from unittest import mock

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "tests"))
sys.path.extend(map(str, ROOT.glob("packages/*/tests")))

from support.film_containers import CONTAINERS, folder, imagej, ome, stack  # noqa: E402
from support.hostile import bytes_like  # noqa: E402
from support.hostile_films import BOMBS, SECONDS_MAX, outcome, small  # noqa: E402
from support.needs_opencv import cv2, video  # noqa: E402
from tetractl_microscope.film import decode, pictures  # noqa: E402
from tetractl_microscope.track import track  # noqa: E402

from tetractl.core.errors import TetractlError  # noqa: E402

MEGABYTES_MAX = 500  # beyond those of the libraries
DRAWN = 300  # one film in so many is followed with -o, which takes seconds
FIELD = b"time_s,direction_rad,strength\n" + b"".join(b"%.1f,%d,1\n" % (k / 5, k) for k in range(9))
SIDES = (1, 2, 3, 7, 16, 17, 64, 250)
OPTIONS = {
    "scale": (2.3, 8.0, 0.05, 100.0, 7.7),
    "rate": (30.0, 0.1, 2000.0, 15.0),
    "organism": ("tetrahymena", "paramecium", "euglena", "yeti"),
}
Files = dict[str, bytes]


def swimming() -> np.ndarray:
    """Some pictures of two bodies that swim straight, with noise."""
    rng = np.random.default_rng(5)
    film = rng.normal(150, 3, (20, 70, 130)).clip(0, 255).astype(np.uint8)
    for k, picture in enumerate(film):
        for i in range(2):
            middle = (20 + 4 * k, 20 + 30 * i)
            cv2.ellipse(picture, middle, (11, 5), 0, 0, 360, 60 + 10 * i, -1, cv2.LINE_AA)
    return film


def seeds(where: Path) -> dict[str, Files]:
    """Return good films: the bytes of their files by name; "" is the name of a film in one file."""
    makers: dict[str, Any] = {name: entry[0] for name, entry in CONTAINERS.items()}
    makers |= {"imagej": imagej, "ome": ome}
    makers |= {
        f"{code}{end}": lambda path, pictures, code=code: video(path, pictures, 30.0, code)
        for code, end in (("MJPG", ".avi"), ("mp4v", ".mp4"))
    }
    made = {}
    for film in (small(), swimming()):
        for name, make in makers.items():
            path = make(where / f"{len(made)} {name}", film)
            parts = sorted(path.iterdir()) if path.is_dir() else [path]
            made[path.name] = {
                part.name if path.is_dir() else "": part.read_bytes() for part in parts
            }
    return made


def mutant(files: Files, rng: random.Random) -> Files:
    """Return a film with some bytes changed in some of its files."""
    changed = dict(files)
    for name in rng.sample(sorted(files), rng.randint(1, min(4, len(files)))):
        data = bytearray(files[name])
        tail = len(data) if rng.random() < 0.5 else min(len(data), 2000)
        for _ in range(rng.choice([1, 1, 2, 4, 16, 64])):
            # the tags are at the end or at the beginning of most files
            at = rng.randrange(tail) if rng.random() < 0.5 else len(data) - 1 - rng.randrange(tail)
            new = rng.choice([rng.randbytes(1), b"\xff\xff\xff\xff", bytes(4), rng.randbytes(4)])
            data[at : at + len(new)] = new
        if rng.random() < 0.15:
            del data[rng.randrange(len(data)) :]
        changed[name] = bytes(data)
    return changed


def odd(path: Path, rng: random.Random) -> None:
    """Write a film of an odd shape, type and range of values."""
    shape = rng.choice((1, 2, 5, 20)), rng.choice(SIDES), rng.choice(SIDES)
    kind = rng.choice(("u1", "u2", "i2", "i4", "f4", "f8"))
    noise = np.random.default_rng(rng.randrange(2**32)).normal(size=shape)
    if rng.random() < 0.3:
        noise = swimming()[: shape[0]] / 25.0
    pictures = (noise * rng.choice((0, 1, 50, 1e4, 1e30)) + rng.choice((0, 100, -5))).astype("f8")
    if kind[0] == "f":
        pictures.flat[:: rng.choice((1, 2, 97))] = rng.choice((np.nan, np.inf, -np.inf, 0.0))
    else:
        limits = np.iinfo(kind)
        pictures = np.clip(pictures, limits.min, limits.max)
    with np.errstate(over="ignore"):
        pictures = pictures.astype(kind)
    if kind in ("u1", "u2") and rng.random() < 0.5:
        folder(path, pictures, rng.choice(("png", "pgm", "bmp", "tif")))
    else:
        stack(path, pictures, compression=rng.choice((None, "zlib")))


def written(path: Path, made: dict[str, Files], rng: random.Random) -> tuple[str, dict[str, Any]]:
    """Write a hostile film and its field; return what it is, and options of `track`."""
    name = rng.choice([*made, "odd", "noise"])
    if name == "odd":
        odd(path, rng)
    elif name == "noise":
        path.write_bytes(rng.choice((b"", b"II*\0", b"RIFF", b"\xff\xd8\xff")) + rng.randbytes(999))
    else:
        files = made[name] if rng.random() < 0.1 else mutant(made[name], rng)
        if "" not in files:
            path.mkdir()
        for part, data in files.items():
            (path / part if part else path).write_bytes(data)
        if path.is_dir() and rng.random() < 0.2:
            times = "".join(f"{k / 9}\n" for k in range(len(files))).encode()
            (path / "times.csv").write_bytes(bytes_like(b"time_s\n" + times, rng))
    words: dict[str, Any] = {}
    for option, (usual, *others) in OPTIONS.items():
        if rng.random() < 0.8:
            words[option] = usual if rng.random() < 0.8 else rng.choice(others)
    if rng.random() < 0.5:
        words["field"] = path.with_name("field.csv")
        words["field"].write_bytes(FIELD if rng.random() < 0.5 else bytes_like(FIELD, rng))
    if rng.randrange(DRAWN) == 0:
        words["out"] = path.with_name("results")
    return name, words


def tracked(path: Path, words: dict[str, Any]) -> tuple[str, str, float]:
    """Follow a film in this process; return how it ended, what was said, and the time [s]."""
    began, said, how = time.perf_counter(), io.StringIO(), ""
    try:
        with redirect_stdout(said), redirect_stderr(said):
            how = f"ended with {int(track(path, **words))}"
    except TetractlError as error:
        how = f"ended with {int(error.exit)}"
    except Exception:
        how, said = "traceback", io.StringIO(traceback.format_exc())
    return how, said.getvalue(), time.perf_counter() - began


class InProcess:
    """Stands for the process that decodes a film: decodes it in this one."""

    def __init__(self, words: list[str], **_: object) -> None:
        self.stdout = tempfile.TemporaryFile()  # noqa: SIM115 - memory is limited
        try:
            with mock.patch.object(faulthandler, "dump_traceback_later"):  # the alarm stands for it
                decode.main(Path(words[-1]), self.stdout)
            self.code = 0
        except Exception:
            self.code = 1
        self.stdout.seek(0)

    def wait(self) -> int:
        return self.code

    def kill(self) -> None:
        pass


def follow_many(first: int, count: int, seed: int, where: Path, out: Connection) -> None:
    """Follow hostile films by their numbers; send each one's name, end, messages and time [s]."""
    made = seeds(where)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    data = int(Path("/proc/self/status").read_text().partition("VmData:")[2].split()[0]) * 1024
    resource.setrlimit(resource.RLIMIT_DATA, (data + MEGABYTES_MAX * 10**6,) * 2)
    with mock.patch.object(pictures, "Child", InProcess):
        for k in range(first, count):
            signal.alarm(int(SECONDS_MAX))
            here = where / f"film-{k}"
            here.mkdir()
            name, words = written(here / "film", made, random.Random(f"{seed} {k}"))
            out.send((name, *tracked(here / "film", words)))
            rmtree(here)
    signal.alarm(0)


def peak_mb() -> float:
    """Peak memory of this process and of its largest child [MB]."""
    who = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return max(resource.getrusage(each).ru_maxrss / 1e3 for each in who)


def main() -> int:
    """Follow some films; print what came of them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=0, help="number of the first film")
    parser.add_argument("--count", type=int, default=100, help="number of the last one, plus 1")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    tally, slowest, failed, ended = Counter(), (0.0, ""), 0, 0

    def note(kind: str, how: str, said: str, seconds: float) -> None:
        nonlocal slowest, failed
        tally[how] += 1
        slowest = max(slowest, (seconds, kind))
        if not how.startswith("ended"):
            failed += 1
            print(f"{kind}: {how}\n{said}\n", flush=True)

    with tempfile.TemporaryDirectory() as name:
        where = Path(name)
        for k, (kind, make) in enumerate(list(BOMBS.items())[: given.count][given.first :]):
            make(where / f"bomb-{k}")
            note(kind, *outcome(where, where / f"bomb-{k}"))
        of_bombs, done = peak_mb(), max(given.first, min(len(BOMBS), given.count))
        while done < given.count:
            ours, theirs = multiprocessing.Pipe(duplex=False)
            scratch = Path(tempfile.mkdtemp(dir=where))
            words = (done, given.count, given.seed, scratch, theirs)
            process = multiprocessing.get_context("fork").Process(target=follow_many, args=words)
            process.start()
            theirs.close()
            try:
                while True:
                    kind, *how = ours.recv()
                    note(f"film {done} ({kind})", *how)
                    done += 1
            except EOFError:
                process.join()
            if done < given.count:  # this film ended the process
                ended += 1
                path, again = where / f"again-{done}" / "film", scratch / "again"
                path.parent.mkdir()
                again.mkdir()
                kind, words = written(path, seeds(again), random.Random(f"{given.seed} {done}"))
                note(f"film {done} ({kind})", *tracked(path, words))
                done += 1
            rmtree(scratch)
    ends = ", ".join(f"{how}: {number}" for how, number in sorted(tally.items()))
    print(
        f"{sum(tally.values())} hostile films, seed {given.seed}: {ends}; {ended} of them ended "
        f"the process that read them; slowest {slowest[0]:.1f} s ({slowest[1]}); peak memory "
        f"{of_bombs:.0f} MB for films made by hand, {peak_mb():.0f} MB for all"
    )
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
