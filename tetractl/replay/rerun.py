"""`tetractl rerun LOG`: run a trial again from its own log, and compare the two logs."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from tetractl.core.errors import Exit, printable

if TYPE_CHECKING:
    from tetractl.experiment.load import LoadedSpec
    from tetractl.experiment.plants import PlantKind


def recorded(log: Path, plant: "PlantKind") -> "tuple[LoadedSpec, int]":
    """Return the spec that a log was run with, on a plant, and its trial's index in the batch.

    A log of the lab has its calibration in the spec already; no file is read for it.
    """
    from tetractl.experiment.load import LoadedSpec
    from tetractl.experiment.plants import on_plant
    from tetractl.log.read.reader import read_trial

    trial = read_trial(log)
    start = trial.start
    spec = LoadedSpec(trial.experiment, start.spec_text, start.spec_name, attached=start.attached)
    if plant == "sim" or trial.experiment.plant.simulated:
        spec = on_plant(spec, plant)
    return spec, start.trial


def compare(log: Path, again: Path) -> int:
    """Print whether two logs of a trial have the same content; FAILED if they have not."""
    from tetractl.log.read.reader import content_digest, read_result, read_trial
    from tetractl.replay.difference import trial_difference
    from tetractl.replay.verify import host_differences

    first, second = read_result(log), read_result(again)
    if not (first.simulated and second.simulated):
        kinds = ("simulated" if one.simulated else "of the lab" for one in (first, second))
        text = "the log is {}, the new one {}: done once more, not repeated"
        print(text.format(*kinds), file=sys.stderr)
        return Exit.DONE
    one, two = (content_digest(path) for path in (log, again))
    if one == two:
        print(f"the content digests agree: {one}", file=sys.stderr)
        return Exit.DONE
    print(f"the content digests differ: {one} in {log}, {two} in {again}", file=sys.stderr)
    was, is_now = read_trial(log), read_trial(again)
    if difference := trial_difference(is_now, was):
        print(printable(f"  {difference}"), file=sys.stderr)
    if first.recovered or not first.outcome.complete:
        print(f"  {log} is of a trial that did not run to its end, or damaged", file=sys.stderr)
    if first.experiment.controller.deadline is not None:
        print("  its spec sets a deadline: plans depend on how fast the host is", file=sys.stderr)
    if was.start.resolved != is_now.start.resolved:
        print("  its spec is written with an earlier tetractl's names or fields", file=sys.stderr)
    for line in host_differences(was):
        print(printable(f"  {line}"), file=sys.stderr)
    return Exit.FAILED
