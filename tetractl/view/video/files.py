"""Films of a trial: MP4 by ffmpeg where it is installed, GIF and animated WebP always."""

import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from tetractl.core.errors import LogError, UsageError
from tetractl.log.read.trial_log import TrialLog
from tetractl.view.video.frames import Frames, Picture

FORMATS = {"mp4": 25, "gif": 20, "webp": 25}
"""Pictures a second; a GIF counts in hundredths of a second."""
WIDTH = 960
HOLD_S = 1.5
"""For how long the last picture stays."""
LONGEST_S = 60.0
SPEEDS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)


def check_file(path: Path) -> str:
    """Return the format of a film by its name.

    Raises UsageError for other names, for a folder that is not there, and for MP4 without ffmpeg.
    """
    ending = path.suffix.lower().removeprefix(".")
    if ending not in FORMATS:
        raise UsageError(
            f"{path}: cannot write '{path.suffix}' films",
            f"end the name in {', '.join('.' + name for name in FORMATS)}",
        )
    if not path.absolute().parent.is_dir():
        raise UsageError(f"{path}: there is no folder {path.parent}")
    if ending == "mp4" and shutil.which("ffmpeg") is None:
        raise UsageError(
            f"{path}: an MP4 is written by ffmpeg, which is not installed",
            "install it, or end the name in .gif or .webp",
        )
    return ending


def write_video(
    log: TrialLog,
    path: Path,
    progress: Callable[[int, int], None] = lambda done, total: None,
    width: int = WIDTH,
) -> int:
    """Write a film of a trial and return how many times faster than the trial it plays.

    A trial of more than a minute plays faster, by 2, 5, 10 and so on. `progress` is called with the
    number of pictures drawn and of all. Raises LogError where the file cannot be written.
    """
    ending = check_file(path)
    rate = FORMATS[ending]
    frames = Frames(log, width)
    recording = frames.recording
    end_s = max(recording.elapsed_s(recording.end_ns), 0.0)
    speed = next((s for s in SPEEDS if end_s / s <= LONGEST_S), SPEEDS[-1])
    times = np.append(np.arange(0, end_s, speed / rate), end_s).tolist()
    hold = round(HOLD_S * rate)

    def pictures() -> Iterator[Picture]:
        for done, time_s in enumerate(times, 1):
            yield frames.at(time_s)
            progress(done, len(times))

    try:
        if ending == "mp4":
            _mp4(path, pictures(), rate, hold)
        else:
            _animation(path, pictures(), len(times), rate, hold)
    except OSError as error:
        path.unlink(missing_ok=True)
        raise LogError(f"{path}: cannot write the film: {error}") from error
    return speed


def _animation(path: Path, pictures: Iterator[Picture], count: int, rate: int, hold: int) -> None:
    """Write a GIF or a WebP; the last picture is shown `hold` times as long."""
    gif = path.suffix.lower() == ".gif"
    milliseconds = round(1000 / rate)
    durations = [milliseconds] * (count - 1) + [milliseconds * (1 + hold)]
    first = Image.fromarray(next(pictures))
    if gif:
        palette = first.quantize(256, dither=Image.Dither.NONE)

        def reduced(picture: Image.Image) -> Image.Image:
            return picture.quantize(palette=palette, dither=Image.Dither.NONE)

        first = reduced(first)
        rest = (reduced(Image.fromarray(picture)) for picture in pictures)
        options: dict[str, Any] = {"optimize": False, "disposal": 1}
    else:
        rest = (Image.fromarray(picture) for picture in pictures)
        options = {"quality": 80, "method": 1, "kmin": 25, "kmax": 50}
    first.save(path, save_all=True, append_images=rest, duration=durations, loop=0, **options)


def _mp4(path: Path, pictures: Iterator[Picture], rate: int, hold: int) -> None:
    first = next(pictures)
    height, width = first.shape[:2]
    command = [
        "ffmpeg", "-y", "-loglevel", "error",
        "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}",
        "-r", str(rate), "-i", "-",
        "-c:v", "libx264", "-preset", "veryfast", "-crf", "20", "-pix_fmt", "yuv420p",
        "-movflags", "+faststart", "-fflags", "+bitexact", "-f", "mp4", str(path),
    ]  # fmt: skip
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdin is not None and process.stderr is not None
        try:
            last = first.tobytes()
            process.stdin.write(last)
            for picture in pictures:
                last = picture.tobytes()
                process.stdin.write(last)
            for _ in range(hold):
                process.stdin.write(last)
            process.stdin.close()
        except BrokenPipeError:
            pass  # ffmpeg ended, and says why
        told = process.stderr.read().decode(errors="replace").strip()
        if process.wait() != 0:
            raise OSError(told.splitlines()[-1] if told else "ffmpeg failed")
