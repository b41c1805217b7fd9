"""A film whose pictures are in memory, as `follow` takes one."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from tetractl_microscope.film.picture_times import PictureTimes
from tetractl_microscope.film.pictures import FilmPictures


class FilmInMemory:
    """Pictures in their order, and their times."""

    damaged = 0

    def __init__(self, path: Path, pictures: list[np.ndarray], timing: PictureTimes) -> None:
        self.path = path
        self.pictures = pictures
        self.timing = timing

    @classmethod
    def read(cls, film: FilmPictures, backwards: bool = False, step: int = 1) -> "FilmInMemory":
        """Return each so many pictures of a film, in their order or backwards."""
        pictures = [picture for _, picture in film][::step]
        timing = PictureTimes(film.rate_hz / step)
        return cls(film.path, pictures[::-1] if backwards else pictures, timing)

    @property
    def rate_hz(self) -> float:
        return self.timing.rate_hz

    def __iter__(self) -> Iterator[tuple[int, np.ndarray]]:
        yield from enumerate(self.pictures)

    def seconds(self, number: int) -> float:
        return self.timing.seconds(number)

    def time_line(self) -> str | None:
        return self.timing.uneven_line()
