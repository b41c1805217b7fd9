"""Films made to hang, crash or fill memory, each followed by `tetractl track`.

The films of tests/support/hostile_films.py, made by hand, come first, then good films with some
bytes changed. Prints what came of them, and the peak memory.
"""

import argparse
import random
import resource
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from support.film_containers import CONTAINERS, imagej, ome  # noqa: E402
from support.hostile_films import BOMBS, outcome, small  # noqa: E402

MEGABYTES_MAX = 500.0


def films(where: Path, rng: random.Random) -> Iterator[tuple[str, Path]]:
    """Write each film made by hand, then mutants without end."""
    for k, (name, make) in enumerate(BOMBS.items()):
        path = where / f"bomb-{k}"
        make(path)
        yield name, path
    yield from mutants(where, rng)


def mutants(where: Path, rng: random.Random) -> Iterator[tuple[str, Path]]:
    """Write good films with some bytes changed, without end."""
    makers = {name: entry[0] for name, entry in CONTAINERS.items()} | {"imagej": imagej, "ome": ome}
    for k in range(sys.maxsize):
        name = rng.choice(sorted(makers))
        path = makers[name](where / f"mutant-{k} {name}", small())
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        for file in rng.sample(files, rng.randint(1, len(files))):
            data = bytearray(file.read_bytes())
            tail = len(data) if rng.random() < 0.5 else min(len(data), 2000)
            for _ in range(rng.choice([1, 1, 2, 4, 16, 64])):
                # the tags are at the end or at the beginning of most files
                at = (
                    rng.randrange(tail)
                    if rng.random() < 0.5
                    else len(data) - 1 - rng.randrange(tail)
                )
                new = rng.choice(
                    [rng.randbytes(1), b"\xff\xff\xff\xff", bytes(4), rng.randbytes(4)]
                )
                data[at : at + len(new)] = new
            if rng.random() < 0.15:
                del data[rng.randrange(len(data)) :]
            file.write_bytes(data)
        yield f"mutant {name}", path


def peak_mb() -> float:
    """Peak memory of this process and of its largest child [MB]."""
    who = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return max(resource.getrusage(each).ru_maxrss / 1e3 for each in who)


def main() -> int:
    """Follow some films; print what came of them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    tally, slowest, failed = Counter(), (0.0, ""), 0
    with tempfile.TemporaryDirectory() as name:
        where = Path(name)
        more = films(where, random.Random(given.seed))
        for _ in range(given.count):
            kind, path = next(more)
            how, said, seconds = outcome(where, path)
            tally[how] += 1
            slowest = max(slowest, (seconds, kind))
            if peak_mb() > MEGABYTES_MAX or not how.startswith("ended"):
                failed += 1
                print(f"{path.name} ({kind}): {how}, {peak_mb():.0f} MB\n{said}\n", flush=True)
    ends = ", ".join(f"{how}: {number}" for how, number in sorted(tally.items()))
    print(
        f"{sum(tally.values())} hostile films, seed {given.seed}: {ends}; slowest "
        f"{slowest[0]:.1f} s ({slowest[1]}); peak memory {peak_mb():.0f} MB"
    )
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
