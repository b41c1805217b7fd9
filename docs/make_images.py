"""Make the pictures of README and docs/, docs/images: figures, a video, the live arena, the player.

Run `python docs/make_images.py` after a change of what they show; it takes some minutes and needs
Chromium for the player. All trials are simulated, that of cells emulated in virtual time.
"""

import io
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image, ImageSequence
from rich.console import Console

ROOT = Path(__file__).parents[1]
IMAGES = ROOT / "docs" / "images"
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "benchmarks")]

from testkit.chromium import chromium  # noqa: E402
from testkit.emulator.virtual_lab import virtual_dish  # noqa: E402

from tetractl.log.read.reader import read_trial  # noqa: E402
from tetractl.log.read.trial_log import TrialLog  # noqa: E402
from tetractl.run.interrupt import Interrupt  # noqa: E402
from tetractl.run.logged_trial import run_logged  # noqa: E402
from tetractl.view.player import Recording  # noqa: E402
from tetractl.view.terminal.dashboard import Dashboard, Footer  # noqa: E402
from tetractl.view.video import write_video  # noqa: E402

FOLDERS = ("published", "ours", "paper")
VIDEO_WIDTH = 640
THIN, COLORS = 5, 48
"""Of the video, the pictures between those that are kept, and its colours: a sixth of the bytes.
With half as many the green of a robot is another one."""
PLAYER = (1280, 830)
"""Width and height of the picture of the player [px]."""
MIDDLE = 0.55
"""The share of the trial after which the player is photographed."""


def tetractl(*args: object) -> None:
    """Run a command of this source."""
    subprocess.run([sys.executable, "-m", "tetractl", *map(str, args)], cwd=ROOT, check=True)


def main() -> None:
    """Run the experiments and make every picture."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:  # Chromium lingers
        folder = Path(name)
        published, bench, paper = (folder / part for part in FOLDERS)
        for spec, out, trials in (
            ("three_m3pi_paper", published, 1),
            ("three_m3pi_bench", bench, 20),
            ("three_m3pi_paper_bench", paper, 20),
        ):
            path = ROOT / "experiments" / f"{spec}.yaml"
            tetractl("run", path, "--set", f"trials.count={trials}", "--out", out, "--quiet")
        first = "trial-000.mcap"
        for log, kind, image in (
            (published / first, "trajectory", "figure-5.png"),
            (published / first, "swarm", "figure-2.png"),
            (bench, "errors", "errors.png"),
            (bench, "batch", "batch.png"),
        ):
            tetractl("plot", log, "--kind", kind, "-o", IMAGES / image)
        with virtual_dish(folder, seed=1) as dish:
            run_logged(dish.spec, folder, 0, [], Interrupt())
        tetractl("plot", folder / first, "--kind", "trajectory", "-o", IMAGES / "dish.png")
        write_video(read_trial(bench / first), folder / "trial.gif", width=VIDEO_WIDTH)
        thin(folder / "trial.gif", IMAGES / "trial.gif")
        live(read_trial(bench / first), IMAGES / "live.svg")
        tetractl("report", bench, paper, "-o", folder / "report.html")
        player(folder / "report.html", folder)


def live(log: TrialLog, out: Path) -> None:
    """Write the live arena of a terminal in the middle of a trial, as text in an SVG."""
    console = Console(record=True, width=100, height=32, file=io.StringIO(), force_terminal=True)
    recording = Recording(log)
    footer = Footer("trial 1 of 20", 0.03, "9 s left", ("Ctrl-C stops",))
    moment = recording.at(round(MIDDLE * recording.end_ns))
    dashboard = Dashboard(moment, f"{log.start.setup.name}, sim", footer)
    console.print(dashboard, height=32)
    out.write_text(console.export_svg(title="tetractl run experiments/three_m3pi_bench.yaml"))


def thin(video: Path, out: Path) -> None:
    """Write a video with fewer pictures and colours, which lasts as long."""
    with Image.open(video) as found:
        pictures = [
            (one.convert("RGB"), one.info["duration"]) for one in ImageSequence.Iterator(found)
        ]
    *moving, (last, hold) = pictures
    palette = last.quantize(COLORS, dither=Image.Dither.NONE)
    kept = [picture for picture, _ in moving[::THIN]] + [last]
    kept = [one.quantize(palette=palette, dither=Image.Dither.NONE) for one in kept]
    durations = [THIN * moving[0][1]] * (len(kept) - 1) + [hold]
    kept[0].save(out, save_all=True, append_images=kept[1:], duration=durations, loop=0, disposal=1)


def player(report: Path, folder: Path) -> None:
    """Photograph a report's player in the middle of a trial."""
    with chromium(folder / "profile") as page:
        page.open(report, *PLAYER)
        page.run(
            "{ const scrub = document.getElementById('scrub');"
            f" scrub.value = {MIDDLE} * player.trial.end;"
            " scrub.dispatchEvent(new Event('input'));"
            " scrub.closest('section').scrollIntoView(); }"
        )
        page.picture(IMAGES / "player.png")


if __name__ == "__main__":
    main()
