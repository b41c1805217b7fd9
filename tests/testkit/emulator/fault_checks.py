"""Checks the expectations of a fault script after a run.

It compares the exit code, the output and the log of the run, and what the robots truly did
according to the emulator's own record.
"""

import re
from pathlib import Path

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log

from testkit.paths import ROOT
from testkit.paths import SCRIPTS as FOLDER
from tetractl.core.obstacles import Obstacles
from tetractl.log.format.channels import LOG
from tetractl.log.read.reader import read_trial
from tetractl.log.read.salvage import scan
from tetractl.spec.load import load_spec
from tetractl.verification.result_check import result_differences

SCRIPTS = sorted(FOLDER.rglob("*.yaml"))


REACTION_S = 0.1  # on top of a fault's own tolerance, until the stop frame is on the wire
ROLLING_S = 0.3  # from the stop frame on the wire until the wheels are at rest


def check(script, played):
    expect = script.expect
    second = [event["says"] for event in played.of("second")]
    said = "\n".join([*played.said, *messages(played.logs), *second])
    note = f"\nsaid: {said}"
    assert played.exits[0] == expect.exit, note
    assert re.search(expect.says, said, re.IGNORECASE), note
    assert "Traceback" not in said
    assert played.emulator_exit == 0
    assert played.link is None or not played.link.is_symlink()
    if expect.outcome == "refused":
        assert not played.of("run"), "no wheel may turn"
        return
    assert played.of("run")
    check_log(expect, played)
    check_motion(expect, played)
    check_space(expect, played)


def messages(logs):
    """What the logs' /log channels say."""
    entries = [entry for log in logs for entry in scan(log).entries if entry.topic == LOG]
    return [Log.FromString(entry.data).message for entry in entries]


def check_log(expect, played):
    """The log is readable and its result, if there could be one, names the fault."""
    (log,) = played.logs
    trial = read_trial(log)
    broke_off = expect.outcome == "killed" or trial.result is None
    # in virtual time a process ends before its first chunk is full
    assert len(trial.mocap_ns) > 0 or (broke_off and played.link is None)
    if broke_off:
        assert trial.damage is not None
        return
    assert [*result_differences(trial, trial.result)] == []
    if expect.outcome == "done":
        assert trial.result.outcome.complete
    else:
        assert trial.result.outcome == expect.outcome
        if expect.outcome == "aborted":
            assert re.search(expect.says, trial.result.reason, re.IGNORECASE)


def check_motion(expect, played):
    """Robots stop in time, and none moves again after a run that ended."""
    names = played.of("ready")[0]["robots"]
    ended = expect.outcome != "done"
    visible_ns = played.seen_ns()
    slack = 0.02
    if visible_ns is not None:
        span = (expect.still or expect.tolerance or 0.0) + REACTION_S + ROLLING_S
        lag = played.lag_s(visible_ns, visible_ns + round(span * 1e9))
        slack += 2 * lag  # both processes share the host
    if visible_ns is not None and expect.tolerance is not None:
        limit = expect.tolerance + REACTION_S + slack
        for name in expect.robots or names:
            assert played.stop_after(name, visible_ns) <= limit, f"{name}'s stop came late"
            if ended:  # else it may start again before it came to rest
                rest = played.rest_after(name, visible_ns)
                assert rest <= limit + ROLLING_S, f"{name} stood late"
                assert not played.moves_after(name, visible_ns), f"{name} moved again"
    if visible_ns is not None and expect.still is not None:
        for name in names:
            assert played.moved_until(name, visible_ns) <= expect.still + slack
    assert played.of("robot", moving=True), "the run did drive"
    last = {event["name"]: event["moving"] for event in played.of("robot")}
    assert not any(last.values())


def check_space(expect, played):
    """True positions: inside the arena, and apart from one another, where that is expected."""
    setup = load_spec(Path(ROOT / "experiments" / "three_m3pi_lab.yaml")).experiment.setup
    arena = setup.arena
    obstacles = Obstacles.from_shapes(setup.obstacles)
    for truth in played.of("truth"):
        spots = [complex(x, y) for x, y, _ in truth["poses"]]
        if expect.inside:
            assert all(arena.contains(spot.real, spot.imag) for spot in spots)
        if expect.clear:
            assert not obstacles.contains(*np.array(truth["poses"]).T[:2]).any()
        if expect.apart_mm is not None:
            gaps = [abs(a - b) for i, a in enumerate(spots) for b in spots[:i]]
            assert min(gaps) >= expect.apart_mm
