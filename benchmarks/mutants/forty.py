"""Plants forty defects one by one, and says which tier of tests finds each.

    python benchmarks/mutants/forty.py              all, some hours
    python benchmarks/mutants/forty.py 3 17 18      some rows of the table

prints the table of benchmarks/mutants/README.md. A row of TABLE is a file, a text that it has once,
what stands there instead, and the tests that mirror the file. The defects were drawn from lines of
each room before its tests were read. Sources are copied first; the tests are run there, tier
by tier, until one fails.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
TIERS = {
    "make test": "not long and not system",
    "make test-ci": "(long or system) and not release",
    "make test-all": "release",
}
LEFT_OUT = shutil.ignore_patterns(".git", ".venv*", "logs", "build", "node_modules", "__pycache__")
TABLE = r"""
tetractl/analysis/analyze.py | least_gap < TOO_ALIKE | least_gap > TOO_ALIKE | tests/unit/analysis/test_analyze.py
tetractl/cli/info.py | min(max(digits, 0), 9) | min(max(digits, 1), 9) | tests/cli/test_info_cli.py
tetractl/control/kernels/clearance.py | range(count) | range(count - 1) | tests/unit/control/kernels/test_clearance.py
tetractl/control/kernels/filter.py | (model, i, z, u) - _turning_rate(model, i, z, u_before) | (model, i, z, u) + _turning_rate(model, i, z, u_before) | tests/unit/control/test_filter.py
tetractl/control/kernels/filter_motion.py | += cos_less_1 * p + s * q + sine_w * ln_w | += cos_less_1 * p - s * q + sine_w * ln_w | tests/unit/control/test_filter.py
tetractl/core/poses.py | / math.sqrt(2) + 4 * self.noise_mm | / math.sqrt(2) + self.noise_mm | tests/unit/lab/test_sight.py
tetractl/core/shape.py | apart |= np.maximum(ay, by) < np.minimum(y0, y1) | apart |= np.minimum(ay, by) < np.minimum(y0, y1) | tests/unit/model/test_shapes.py
tetractl/experiment/experiment.py | self.on_lost == "stop" and not on_wheels | self.on_lost == "stop" and on_wheels | tests/unit/experiment tests/unit/run/test_losses.py
tetractl/experiment/yaml/core_yaml.py | column = len(before) - before.rfind("\n") - 1 | column = len(before) - before.rfind("\n") | tests/unit/experiment/yaml
tetractl/gym.py | set(options or {}) - {"trial"} | set(options or {}) - {"trial", "seed"} | tests/unit/test_gym.py
tetractl/lab/actuators/m3pi/broadcast.py | (self._sequence + 1) % 256 | (self._sequence + 1) % 255 | tests/unit/lab/actuators
tetractl/lab/calibrate.py | (forwards - backwards) / 2 | (forwards + backwards) / 2 | tests/unit/lab/test_calibrate.py packages/tetractl-emulator/tests/plays/test_lab_commands.py
tetractl/log/read/overview.py | (len(entries) - 1) * SECOND / span_ns | len(entries) * SECOND / span_ns | tests/unit/log tests/cli/test_info_cli.py
tetractl/log/read/recover.py | max((entry.log_ns for entry in contents.entries), default=0) | min((entry.log_ns for entry in contents.entries), default=0) | tests/unit/log/read
tetractl/model/motion/exact.py | a * p - m * alternating(k, first_b, len(k), q) | a * p + m * alternating(k, first_b, len(k), q) | tests/unit/control/kernels/test_prediction.py
tetractl/core/obstacles.py | return self.distance(x, y) <= 0 | return self.distance(x, y) < -1 | tests/unit/core/test_obstacles.py
tetractl/plant/direct.py | np.sin(direction - answered)[reached] | np.sin(answered - direction)[reached] | tests/unit/plant
tetractl/plant/disturbances/robots.py | min(1.0, time_s / self._section.over) | max(1.0, time_s / self._section.over) | tests/unit/plant
tetractl/replay/identification/response.py | np.maximum(SETTLED * std, LEAST_CHANGE)).all() | np.maximum(SETTLED * std, LEAST_CHANGE)).any() | tests/unit/replay/test_response.py
tetractl/replay/lab_result.py | (log.received_ns > first_step_ns) | (log.received_ns < first_step_ns) | tests/unit/replay/test_verify.py
tetractl/report/page.py | max(CARRIED_MIN, CARRIED // groups) | min(CARRIED_MIN, CARRIED // groups) | tests/unit/report tests/cli/test_report_cli.py
packages/tetractl-papers/tetractl_papers/claim.py | values = values - subtracted | values = values + subtracted | packages/tetractl-papers/tests
tetractl/results/mean_difference.py | values.mean - values.ci95.low, values.ci95.high - values.mean | values.mean - values.ci95.low, values.mean - values.ci95.low | tests/unit/results tests/unit/study
tetractl/run/plausibility.py | return least > max(robots * self.tolerance | return least > min(robots * self.tolerance | tests/unit/run/test_plausibility.py
tetractl/run/motion_at_rest.py | distances > DISTANCE_STDS * np.sqrt(variance.sum(axis=1)) | distances > np.sqrt(variance.sum(axis=1)) | tests/unit/run
tetractl/serve/live.py | if entry.log_ns > self._time_ns: | if entry.log_ns < self._time_ns: | tests/unit/serve
tetractl/study/sweep.py | self._between(self.low, self.high + 1, share) | self._between(self.low, self.high, share) | tests/unit/study
tetractl/testing/device_checks.py | 0 <= age_ns <= SECOND | 0 <= age_ns | tests/unit/test_testing.py
tetractl/tools/table/csv_rows.py | if separator == BLANKS: | if separator != BLANKS: | tests/unit/tools
tetractl/view/figures/errors.py | np.searchsorted(log.frames_s, time_s, side="right") - 1 | np.searchsorted(log.frames_s, time_s, side="left") - 1 | tests/unit/view/figures
packages/tetractl-emulator/tetractl_emulator/pictures/field.py | if reply and not self.acting.of("mute"): | if reply: | packages/tetractl-microscope/tests/unit/coils
packages/tetractl-microscope/tetractl_microscope/apriltag/floor.py | (shift.ravel() - self.shift.ravel()) | (shift.ravel() + self.shift.ravel()) | packages/tetractl-microscope/tests/unit/apriltag
packages/tetractl-microscope/tetractl_microscope/cells/match.py | blob_um2 > LARGE * cell.size.area_um2 | blob_um2 < LARGE * cell.size.area_um2 | packages/tetractl-microscope/tests/unit/cells
packages/tetractl-microscope/tetractl_microscope/choice/choosing.py | max(combinations_of_cells, | min(combinations_of_cells, | packages/tetractl-microscope/tests/unit/test_ranked.py
packages/tetractl-microscope/tetractl_microscope/coils/section.py | sin * x + cos * y | sin * x - cos * y | packages/tetractl-microscope/tests/unit/coils
packages/tetractl-microscope/tetractl_microscope/film/who.py | bisect_left(self.times, seconds - ROUNDING_S) | bisect_left(self.times, seconds + ROUNDING_S) | packages/tetractl-microscope/tests/unit/film
packages/tetractl-microscope/tetractl_microscope/pictures/multipart.py | [start : start + length] | [start : start + length - 1] | packages/tetractl-microscope/tests/unit/pictures
packages/tetractl-microscope/tetractl_microscope/results/cell_tables.py | middles = since + weights / 2 | middles = since + weights | packages/tetractl-microscope/tests
packages/tetractl-motioncapture/tetractl_motioncapture/camera.py | UpAxis.Z if section.up_axis == "z" else UpAxis.Y | UpAxis.Y | packages/tetractl-motioncapture/tests
packages/tetractl-toio/tetractl_toio/emulated/mat.py | self.acting.carried or self.acting.of("untracked", cube.name) | self.acting.of("untracked", cube.name) | packages/tetractl-toio/tests
"""  # noqa: E501


def found_by(row: str) -> str:
    """Return the tier and the test that find the defect of a row."""
    name, old, new, tests = row.split(" | ")
    with tempfile.TemporaryDirectory() as scratch:
        tree = Path(scratch) / "tetractl"
        shutil.copytree(ROOT, tree, ignore=LEFT_OUT)
        text = (tree / name).read_text()
        assert text.count(old) == 1, f"{name} has not once: {old}"
        (tree / name).write_text(text.replace(old, new))
        packages = [str(path) for path in (tree / "packages").iterdir()]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(tree), *packages])}
        for tier, marks in TIERS.items():
            words = [sys.executable, "-m", "pytest", "-x", "-m", marks, *tests.split()]
            done = subprocess.run(words, cwd=tree, env=environment, capture_output=True, text=True)
            failed = [line for line in done.stdout.splitlines() if line[:6] in ("FAILED", "ERROR ")]
            if failed:
                return f"`{tier}` | {failed[0].split(' - ')[0]}"
    return "none | survives"


def main() -> None:
    rows = TABLE.strip().splitlines()
    print("| defect | in | found by | first test |", "|--:|---|---|---|", sep="\n")
    for number in map(int, sys.argv[1:] or range(1, len(rows) + 1)):
        row = rows[number - 1]
        print(f"| {number} | `{row.split(' | ')[0]}` | {found_by(row)} |", flush=True)


if __name__ == "__main__":
    main()
