"""The rows of the table: scores over films, with n and 95 % intervals."""

from collections.abc import Callable, Sequence

import numpy as np
import scipy

from .scores import FilmScore

RESAMPLED = 1000  # bootstrap samples of the films


def total(films: Sequence[FilmScore], name: str) -> float:
    return sum(getattr(film, name) for film in films)


def f1(films: Sequence[FilmScore]) -> float:
    return 2 * total(films, "found") / _rows_shown_and_true(films)


def idf1(films: Sequence[FilmScore]) -> float:
    return 2 * total(films, "named") / _rows_shown_and_true(films)


def _rows_shown_and_true(films: Sequence[FilmScore]) -> float:
    return max(2 * total(films, "found") + total(films, "missed") + total(films, "extra"), 1)


def root(squares: str, count: str) -> Callable[[Sequence[FilmScore]], float]:
    return lambda films: (total(films, squares) / max(total(films, count), 1)) ** 0.5


def share(hits: int, count: int) -> str:
    """A share with its interval after Clopper and Pearson."""
    low = scipy.stats.beta.ppf(0.025, hits, count - hits + 1) if hits else 0.0
    high = scipy.stats.beta.ppf(0.975, hits + 1, count - hits) if hits < count else 1.0
    return f"{hits} of {count} = {hits / max(count, 1):.2f} [{low:.2f}, {high:.2f}]"


def over_films(
    films: Sequence[FilmScore], value: Callable[[Sequence[FilmScore]], float], digits: int
) -> str:
    """A value with its interval by drawing films again."""
    random = np.random.default_rng(0)
    drawn = []
    for _ in range(RESAMPLED):
        indices = random.integers(0, len(films), len(films))
        drawn.append(value([films[i] for i in indices]))
    low, high = np.quantile(drawn, (0.025, 0.975))
    return f"{value(films):.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def wrong_names(films: Sequence[FilmScore]) -> float:
    wrong = sum(len(film.wrong) for film in films)
    return wrong / max(total(films, "hours"), 1e-9)


def called_sure(films: Sequence[FilmScore]) -> float:
    """Return the share of the right rows."""
    return total(films, "covered") / max(total(films, "right"), 1)


def counts(films: Sequence[FilmScore], name: str) -> tuple[int, int]:
    """Return of how many of all films' intervals something is true, and how many there are."""
    holds = [interval_holds for film in films for interval_holds in getattr(film, name)]
    return sum(holds), len(holds)


def table(films: Sequence[FilmScore], numbers: bool = True) -> list[tuple[str, str]]:
    """Return the rows (what, figure) of films of one level; `numbers` if intervals are stated."""
    worst = min(films, key=lambda film: film.f1)
    rows = [
        ("films, cell-hours", f"{len(films)}, {total(films, 'hours'):.3f}"),
        ("F1", over_films(films, f1, 4)),
        ("worst film's F1", f"{worst.f1:.3f} ({worst.film})"),
        ("position apart, um", over_films(films, root("place2", "near"), 2)),
        ("IDF1", over_films(films, idf1, 3)),
        ("wrong names that last, a cell-hour", over_films(films, wrong_names, 1)),
    ]
    return rows + _stated(films) if numbers else rows


def _stated(films: Sequence[FilmScore]) -> list[tuple[str, str]]:
    """What is stated of names and numbers, and how often that is right."""
    wrong = [sure for film in films for sure in film.wrong]
    return [
        ("heading of the helix, rad", over_films(films, root("heading2", "headings"), 3)),
        ("of the wrong names called sure", f"{sum(wrong)} of {len(wrong)}"),
        ("right rows that are called sure", over_films(films, called_sure, 3)),
        ("95 % interval of a holds", share(*counts(films, "a"))),
        ("95 % interval of the speed holds", share(*counts(films, "speed"))),
        ("strangers whose a is said not to be 0", share(*counts(films, "strangers"))),
    ]
