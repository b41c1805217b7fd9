"""What `tetractl track` says of a film, as rows to be scored."""

from dataclasses import dataclass
from pathlib import Path

from tetractl_microscope.film.field_file import read_field
from tetractl_microscope.film.fit_cell import fit_cells
from tetractl_microscope.film.follow import follow
from tetractl_microscope.film.pictures import open_film

from .in_memory import FilmInMemory
from .scores import Shown


@dataclass(frozen=True, slots=True)
class Setting:
    """Whether the tracker reads the field's record, and that it sees each `step`-th picture."""

    has_field: bool
    step: int


SETTINGS = {
    "field-30hz": Setting(has_field=True, step=1),
    "no-field-30hz": Setting(has_field=False, step=1),
    "field-10hz": Setting(has_field=True, step=3),
    "no-field-10hz": Setting(has_field=False, step=3),
}


def track(folder: Path, um_px: float, setting: Setting) -> Shown:
    """Run the pipeline of track.py on the film in a folder: decode, follow, fit."""
    field = read_field(folder / "field.csv") if setting.has_field else None
    film = open_film(folder / "film.avi", None, um_px)
    if setting.step > 1:
        film = FilmInMemory.read(film, step=setting.step)
    followed = follow(film, um_px, field)
    followed, cells = fit_cells(followed, field)
    result = Shown.of(followed)
    for cell in cells:
        said = {"speed": cell.speed_um_s, "a": cell.a_rad_s}
        result.numbers[int(cell.cell)] = {
            name: (float(interval.low), float(interval.high))
            for name, interval in said.items()
            if interval is not None
        }
    return result
