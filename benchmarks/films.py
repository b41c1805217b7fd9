"""How well cells are found and followed in films of two renderers that share no code.

    python benchmarks/films.py score     F1, positions, names, intervals of `tetractl track`
    python benchmarks/films.py peers     the same of trackpy and laptrack on plain detections
    python benchmarks/films.py rules     what each rule of the tracker is worth, on three drawn
                                         films in each --setting, and on a given one
    python benchmarks/films.py reversed  bodies under positions of a given film, links that the film
                                         run backwards contradicts, bodies followed; trackpy's, too

`score` gives each film in four ways: with the field's record and without, at the film's 30 Hz, and
every third picture alone, at 10 Hz.

`rules --without RULE` takes out this one alone; `filmworld/taken_out.py` lists them.

Every film is synthetic, except that given to `reversed`. Both renderers were made by
the hands that made the tracker. Seeds from 9000 on are those of the published figures; smaller ones
were used in development. Films stay in the folder --cache, and are not rendered twice.
"""

import argparse
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import cv2

sys.path.insert(0, str(Path(__file__).parent))
from filmworld.in_memory import FilmInMemory
from filmworld.ours import SETTINGS, Setting, track
from filmworld.rows import called_sure, f1, idf1, table
from filmworld.scores import FilmScore, Shown, score_film
from filmworld.taken_out import RULES, without
from filmworld.truth import LEVELS, FilmTruth, write_film
from tetractl_microscope.cells.field_record import FieldRecord
from tetractl_microscope.film.field_file import read_field
from tetractl_microscope.film.follow import follow
from tetractl_microscope.film.pictures import open_film
from tetractl_microscope.organisms import named

RENDERERS = ("first", "second")
CELLS = 20  # with a magnet, in a film
RULE_FILMS = (("second", "normal"), ("first", "hard"), ("second", "hard"))


def rendered(cache: Path, renderer: str, level: str, seed: int, cells: int = CELLS) -> Path:
    """Return the folder of a film of so many cells, which is rendered if it is not there."""
    folder = cache / f"{renderer}-{level}-{seed}{'' if cells == CELLS else f'-{cells}'}"
    if not folder.exists():
        if renderer == "first":
            from filmworld.first import first_film as film
        else:
            from filmworld.second import second_film as film
        write_film(folder, *film(seed, level, cells))
    return folder


def scored(
    cache: Path, renderer: str, level: str, tracker: str, setting: str, seed: int
) -> FilmScore:
    """Track one film, and score it."""
    folder = rendered(cache, renderer, level, seed)
    truth = FilmTruth.load(folder / "truth.npz").thinned(SETTINGS[setting].step)
    return score_film(folder.name, truth, tracked(tracker, folder, truth, setting))


def tracked(tracker: str, folder: Path, truth: FilmTruth, setting: str) -> Shown:
    if tracker == "tetractl":
        return track(folder, truth.um_px, SETTINGS[setting])
    from filmworld.peers import PEERS

    return PEERS[tracker](folder, truth.um_px)


Scores = dict[str, dict[str, list[FilmScore]]]
"""The scores of films by renderer and setting."""


def score(chosen: argparse.Namespace, trackers: tuple[str, ...] = ("tetractl",)) -> None:
    """Print the rows of each renderer and level, and of each level over both renderers."""
    seeds = range(chosen.first_seed, chosen.first_seed + chosen.count)
    for level in chosen.level:
        for tracker in trackers:
            films: Scores = {}
            for renderer in chosen.renderer:
                films[renderer] = {setting: [] for setting in chosen.setting}
                for setting, scores in films[renderer].items():
                    for seed in seeds:
                        film = scored(chosen.cache, renderer, level, tracker, setting, seed)
                        scores.append(film)
                        wrong = f"{len(film.wrong)} wrong names" if film.wrong else ""
                        print(
                            f"  {film.film}: {tracker} {setting} F1 {film.f1:.4f} {wrong}",
                            flush=True,
                        )
            show(films, level, tracker)


def show(films: Scores, level: str, tracker: str) -> None:
    """Print the rows of a level, with a column for each setting, for each renderer and over all."""
    if len(films) > 1:
        settings = next(iter(films.values()))
        by_name = {}
        for name in settings:
            by_name[name] = [film for scored in films.values() for film in scored[name]]
        films = films | {"both renderers": by_name}
    for renderer, by_setting in films.items():
        columns = [
            dict(table(scored, tracker == "tetractl")) for scored in by_setting.values() if scored
        ]
        print(f"\n## {renderer}, {level}, {tracker}\n")
        print(f"| | {' | '.join(name for name, scored in by_setting.items() if scored)} |")
        print(f"|---|{'---|' * len(columns)}")
        for what in columns[0]:
            print(f"| {what} | {' | '.join(column[what] for column in columns)} |")
    print(flush=True)


def peers(chosen: argparse.Namespace) -> None:
    from filmworld.peers import PEERS

    chosen.setting = ["field-30hz"]  # they read no field
    score(chosen, tuple(PEERS))


def rules(chosen: argparse.Namespace) -> None:
    """Print a row for each rule, or for those of --without: the measures of a given film without
    the field, if there is one, and of RULE_FILMS in each setting. Places are not smoothed.
    """
    from filmworld.without_truth import body_masks, followed, no_body, unfitted

    drawn = [film for setting in chosen.setting for film in rule_films(chosen, SETTINGS[setting])]
    film = None
    bodies = []
    if chosen.film is not None:
        film = FilmInMemory.read(open_film(chosen.film, chosen.rate, chosen.scale))
        film.pictures = film.pictures[: chosen.pictures]
        bodies = body_masks(film.pictures, chosen.darker)
    of_film = "" if film is None else "no body | followed | "
    print(f"| taken out | {of_film}F1 | IDF1 | wrong names, called sure | sure |")
    for rule in ("", *(chosen.without or RULES)):
        cells = [rule or "none"]
        with without(rule):
            if film is not None:
                rows, _ = unfitted(film, chosen.scale, named(chosen.organism))
                cells += ["{} of {}".format(*m(rows, bodies)) for m in (no_body, followed)]
            scores = [
                score_film(str(film.path), truth, Shown.of(follow(film, truth.um_px, field)))
                for film, truth, field in drawn
            ]
        wrong = [sure for score in scores for sure in score.wrong]
        cells += [f"{f1(scores):.4f}", f"{idf1(scores):.3f}"]
        cells += [f"{len(wrong)}, {sum(wrong)}", f"{called_sure(scores):.3f}"]
        print(f"| {' | '.join(cells)} |", flush=True)


def rule_films(
    chosen: argparse.Namespace, setting: Setting
) -> Iterator[tuple[FilmInMemory, FilmTruth, FieldRecord | None]]:
    """Yield RULE_FILMS in a setting: the pictures, the truth, and the field if it is read."""
    for renderer, level in RULE_FILMS:
        folder = rendered(chosen.cache, renderer, level, chosen.first_seed, chosen.cells)
        truth = FilmTruth.load(folder / "truth.npz").thinned(setting.step)
        film = open_film(folder / "film.avi", None, truth.um_px)
        field = read_field(folder / "field.csv") if setting.has_field else None
        yield FilmInMemory.read(film, step=setting.step), truth, field


def of_film(chosen: argparse.Namespace) -> None:
    """Print what is known of a film without a truth."""
    from filmworld.without_truth import report

    report(chosen.film, chosen.organism, chosen.rate, chosen.scale, chosen.darker)


PARTS = {"score": score, "peers": peers, "rules": rules, "reversed": of_film}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("film", type=Path, nargs="?", help="the film of `reversed`, or `rules`")
    parser.add_argument("--renderer", nargs="+", choices=RENDERERS, default=list(RENDERERS))
    parser.add_argument("--level", nargs="+", choices=LEVELS, default=list(LEVELS))
    parser.add_argument(
        "--setting",
        nargs="+",
        choices=list(SETTINGS),
        help="all, if not given; of `rules`: no-field-10hz",
    )
    parser.add_argument("--cells", type=int, default=CELLS, help="of `rules`: in each film")
    parser.add_argument("--count", type=int, default=15, help="films of each kind")
    parser.add_argument("--first-seed", type=int, default=9000)
    parser.add_argument("--cache", type=Path, help="folder of the films; else a temporary one")
    parser.add_argument("--scale", type=float, help="of a given film, if it states none")
    parser.add_argument("--rate", type=float, help="of a given film, if it states none")
    parser.add_argument("--organism", default="euglena", help="of `reversed`")
    parser.add_argument(
        "--darker",
        type=float,
        default=8.0,
        help="of `reversed`: grey levels of a body; < 0: lighter",
    )
    parser.add_argument("--pictures", type=int, help="of `rules`: first pictures of its film")
    parser.add_argument(
        "--without", nargs="*", choices=list(RULES), default=[], help="of `rules`: these alone"
    )
    chosen = parser.parse_args()
    cv2.setNumThreads(1)
    if chosen.setting is None:
        chosen.setting = ["no-field-10hz"] if chosen.part == "rules" else list(SETTINGS)
    if chosen.part == "reversed" and chosen.film is None:
        parser.error("reversed needs a film")
    with tempfile.TemporaryDirectory() as folder:
        chosen.cache = chosen.cache or Path(folder)
        PARTS[chosen.part](chosen)


if __name__ == "__main__":
    main()
