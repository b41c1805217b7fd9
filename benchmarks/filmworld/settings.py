"""How a film is given to a tracker: with or without the field's record, and at which rate."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tetractl_microscope.film.picture_times import PictureTimes
from tetractl_microscope.film.pictures import FilmPictures


@dataclass(frozen=True, slots=True)
class Setting:
    """Whether the tracker reads the field's record, and that it sees `every` so many pictures."""

    has_field: bool
    every: int


SETTINGS = {
    "field-30hz": Setting(has_field=True, every=1),
    "no-field-30hz": Setting(has_field=False, every=1),
    "field-10hz": Setting(has_field=True, every=3),
    "no-field-10hz": Setting(has_field=False, every=3),
}


class ThinnedFilm:
    """Every so many pictures of a film, as `follow` takes one."""

    damaged = 0

    def __init__(self, film: FilmPictures, every: int) -> None:
        self.path: Path = film.path
        self.timing = PictureTimes(film.rate_hz / every)
        self._film = film
        self._every = every

    @property
    def rate_hz(self) -> float:
        return self.timing.rate_hz

    def __iter__(self) -> Iterator[tuple[int, np.ndarray]]:
        for number, picture in self._film:
            if number % self._every == 0:
                yield number // self._every, picture

    def seconds(self, number: int) -> float:
        return self.timing.seconds(number)

    def time_line(self) -> None:
        return None
