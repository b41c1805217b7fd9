"""What `tetractl track` says of a film without a truth, at several scales."""

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np


def report(film: Path, scales: Sequence[float], rate_hz: float | None) -> None:
    """Print for each scale how many cells are found, for how long, how fast, and what is said."""
    for scale in scales:
        command = [sys.executable, "-m", "tetractl", "track", str(film), "--json"]
        command += ["--scale", str(scale)] if scale else []
        command += ["--rate", str(rate_hz)] if rate_hz else []
        done = subprocess.run(command, capture_output=True, text=True)
        name = f"{scale:g} um/px" if scale else "no scale given"
        print(f"\n## {film.name}, {name}: exit {done.returncode}\n\n{done.stderr.strip()}")
        if done.stdout:
            said = json.loads(done.stdout)
            cells = said["cells"]
            seconds = [cell["duration_s"] for cell in cells] or [0.0]
            count = max(said["pictures"], 1)
            shares = [cell["pictures"] / count for cell in cells] or [0.0]
            print(f"| {said['um_per_px']:.3g} um/px, {said.get('organism')} | {len(cells)} cells |")
            print(
                f"| seen for, s: median, longest | {np.median(seconds):.2f}, {max(seconds):.2f} |"
            )
            print(f"| share of the pictures, median | {np.median(shares):.2f} |")
            speeds = [c["speed_um_s"] for c in cells if c["speed_um_s"]]
            print(f"| speed stated | {len(speeds)} |", flush=True)
