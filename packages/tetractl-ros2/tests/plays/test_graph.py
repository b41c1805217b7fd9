"""Tests over real DDS on the loopback interface, with robots that another vendor's DDS drives.

Some robots are emulated by tetractl. The others run in the witness (`tests/witness`), a C++ program
that shares no code with tetractl: it uses eProsima Fast DDS, with types generated from ROS 2's
definitions. Some tests kill a process by SIGKILL; the robots must then stop within their watchdog.
"""

import contextlib
import json
import os
import shutil
import signal
import subprocess
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="tetractl-ros2 needs cyclonedds")
from testkit.cli import tetractl
from testkit.running import TETRACTL, environment

from tetractl.core.clock import SECOND, MonotonicClock, host_ns, wait_for

pytestmark = [pytest.mark.slow, pytest.mark.system]
WITNESS = Path(__file__).parents[1] / "witness"
LOOPBACK = """<CycloneDDS><Domain>
<General><Interfaces><NetworkInterface name="lo"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex>
<MaxAutoParticipantIndex>40</MaxAutoParticipantIndex>
<Peers><Peer address="localhost"/></Peers></Discovery></Domain></CycloneDDS>"""
DOMAIN = 30 + os.getpid() % 40
PATIENCE_S = 120
WATCHDOG_S = 0.5
NO_POSES_S = 0.1  # time without poses after which the guard stops all robots
LAG_S = 0.4  # ten time constants of the wheels: from 0.2 m/s to 0.01 mm/s
BUSY_S = 0.3  # a busy host's delay of a robot's loop
BEGUN = 60_000  # bytes of a log in which robots drive
# steps that a busy host delays end no run
LATE = ("--set", "lab.limits.late_steps=100000")
LONG = ("--set", "controller.deadline=60", "--set", "controller.time_limit=60")
ROBOTS = {"green": (0.5, 0.6), "blue": (0.5, 1.2), "red": (0.5, 1.8)}
CLOCK = MonotonicClock()


@pytest.fixture
def lab(tmp_path, monkeypatch):
    """A folder with the spec of a new lab, in a domain of its own on the loopback interface."""
    (tmp_path / "loopback.xml").write_text(LOOPBACK)
    monkeypatch.setenv("CYCLONEDDS_URI", f"file://{tmp_path}/loopback.xml")
    words = ("--lab", "--camera", "ros2", "--robots", "ros2")
    tetractl(tmp_path, "init", "graph", *words).ok()
    spec = tmp_path / "graph.yaml"
    spec.write_text(spec.read_text().replace("domain: 0 ", f"domain: {DOMAIN} "))
    return tmp_path


@contextlib.contextmanager
def started(folder, *words, output="output.txt"):
    """A process whose standard output goes to a file; killed at the end."""
    with (folder / output).open("w") as stream:
        environ = environment() | {"CYCLONEDDS_URI": os.environ["CYCLONEDDS_URI"]}
        process = subprocess.Popen(
            [*map(str, words)], cwd=folder, stdout=stream, stderr=subprocess.STDOUT, env=environ
        )
        try:
            yield process
        finally:
            process.kill()
            process.wait()


def says(folder, output, text):
    return wait_for(CLOCK, lambda: text in (folder / output).read_text(), PATIENCE_S)


def run_words(*more):
    return (TETRACTL, "run", "graph.yaml", "--plant", "lab", "--trials", "1", "--yes", *LATE, *more)


def drives(folder, run):
    """Wait until the run's robots drive; return whether it still runs then."""

    def begun():
        parts = (folder / "logs").glob("trial-000.mcap*")
        return run.poll() is not None or any(part.stat().st_size > BEGUN for part in parts)

    return wait_for(CLOCK, begun, PATIENCE_S) and run.poll() is None


@contextlib.contextmanager
def emulated(lab):
    """The emulated lab on real DDS."""
    words = (TETRACTL, "lab", "emulate", "graph.yaml", "--record", "truth.jsonl")
    with started(lab, *words, output="emulation.txt") as emulation:
        assert says(lab, "emulation.txt", "ready"), (lab / "emulation.txt").read_text()
        yield emulation


def test_emulated_robots_are_driven_over_dds(lab):
    """They drive and then stand. On a busy host, the guard may end the trial before its targets."""
    with emulated(lab):
        checked = tetractl(lab, "lab", "check", "graph.yaml")
        assert "emulated: camera, actuator" in checked.stdout
        words = run_words("--set", "controller.time_limit=60", "--out", "logs")
        with started(lab, *words, output="run.txt") as run:
            run.wait(PATIENCE_S)
        assert list((lab / "logs").glob("trial-000.mcap*"))
        record = lab / "truth.jsonl"
        wait_for(CLOCK, lambda: all_stand(record), PATIENCE_S)
        moved = {e["name"] for e in events_of(record) if e["event"] == "robot" and e["moving"]}
        assert moved == set(ROBOTS)
        assert all_stand(record)


@pytest.mark.release
def test_emulated_robots_reach_their_targets_over_dds(lab):
    with emulated(lab):
        with started(lab, *run_words("--out", "logs"), output="run.txt") as run:
            run.wait(PATIENCE_S)
        assert "1 of 1 trials valid" in (lab / "run.txt").read_text()


def test_emulated_robots_stand_within_their_watchdog_when_the_run_is_killed(lab):
    with emulated(lab), started(lab, *run_words(*LONG, "--out", "logs"), output="run.txt") as run:
        assert drives(lab, run), (lab / "run.txt").read_text()
        run.send_signal(signal.SIGKILL)
        killed_ns = host_ns()  # the record has this clock's times
        record = lab / "truth.jsonl"
        wait_for(CLOCK, lambda: all_stand(record), PATIENCE_S)
        stood_ns = max(
            e["t_ns"] for e in events_of(record) if e["event"] == "robot" and not e["moving"]
        )
        assert all_stand(record)
        assert 0 < (stood_ns - killed_ns) / SECOND < WATCHDOG_S + LAG_S + BUSY_S


def events_of(record):
    """The events that the emulation has recorded; its last line may be incomplete."""
    return [json.loads(line) for line in record.read_text().splitlines()[:-1]]


def all_stand(record):
    moving = {}
    for event in events_of(record):
        if event["event"] == "robot":
            moving[event["name"]] = event["moving"]
    return len(moving) == len(ROBOTS) and not any(moving.values())


def test_a_second_program_of_this_computer_cannot_drive_the_robots(lab):
    with emulated(lab), started(lab, *run_words(*LONG, "--out", "logs"), output="run.txt") as run:
        assert drives(lab, run), (lab / "run.txt").read_text()
        second = tetractl(lab, *run_words("--out", "second")[1:])
        assert second.returncode == 1 and "another program has this port open" in second.stderr


@pytest.fixture(scope="module")
def witness(tmp_path_factory):
    """The compiled witness."""
    header = Path("/usr/include/fastdds/dds/domain/DomainParticipant.hpp")
    if not (shutil.which("fastddsgen") and shutil.which("g++") and header.exists()):
        pytest.skip("needs Debian's libfastrtps-dev, libfastcdr-dev, fastddsgen and g++")
    folder = tmp_path_factory.mktemp("witness")
    subprocess.run([WITNESS / "build.sh", folder], check=True, capture_output=True)
    return folder / "witness"


@contextlib.contextmanager
def witnessed(lab, witness):
    """Three robots and a tracker of the witness; yields their processes by name."""
    spec = lab / "graph.yaml"
    text = spec.read_text()
    for name in ROBOTS:
        text = text.replace(f", battery: /{name}/battery_state", "")
    spec.write_text(text)
    with contextlib.ExitStack() as stack:
        processes = {}
        for name, (x, y) in ROBOTS.items():
            words = (witness, DOMAIN, "robot", name, x, y, 0, 0.08, WATCHDOG_S)
            processes[name] = stack.enter_context(started(lab, *words, output=f"{name}.txt"))
        words = (witness, DOMAIN, "tracker", *ROBOTS)
        processes["tracker"] = stack.enter_context(started(lab, *words, output="tracker.txt"))
        yield processes


def stood_ns(lab):
    """When each robot of the witness came to rest [ns], None for one that moves."""
    times = {}
    for name in ROBOTS:
        lines = (lab / f"{name}.txt").read_text().split("\n")[:-1]
        state, _, time_ns = lines[-1].partition(" ") if lines else ("", "", "")
        times[name] = int(time_ns) if state == "stands" else None
    return times


def stand_after(lab, killed_ns):
    """How long after this time the last robot stood [s]."""
    assert wait_for(CLOCK, lambda: None not in stood_ns(lab).values(), PATIENCE_S)
    return (max(stood_ns(lab).values()) - killed_ns) / SECOND


@pytest.mark.release
def test_robots_of_another_vendors_dds_are_driven_to_their_targets(lab, witness):
    with (
        witnessed(lab, witness),
        started(lab, *run_words("--out", "logs"), output="run.txt") as run,
    ):
        run.wait(PATIENCE_S)
        printed = (lab / "run.txt").read_text()
        assert "1 of 1 trials valid" in printed and "flagged" not in printed


@pytest.mark.release
def test_robots_of_another_vendors_dds_stand_when_the_run_is_killed(lab, witness):
    with (
        witnessed(lab, witness),
        started(lab, *run_words(*LONG, "--out", "logs"), output="run.txt") as run,
    ):
        assert drives(lab, run), (lab / "run.txt").read_text()
        run.send_signal(signal.SIGKILL)
        assert 0 < stand_after(lab, host_ns()) < WATCHDOG_S + LAG_S + BUSY_S


@pytest.mark.release
def test_robots_of_another_vendors_dds_stand_when_their_tracker_is_killed(lab, witness):
    """The guard stops them NO_POSES_S after the last pose, before their watchdogs do."""
    with (
        witnessed(lab, witness) as processes,
        started(lab, *run_words(*LONG, "--out", "logs"), output="run.txt") as run,
    ):
        assert drives(lab, run), (lab / "run.txt").read_text()
        processes["tracker"].send_signal(signal.SIGKILL)
        assert 0 < stand_after(lab, host_ns()) < NO_POSES_S + LAG_S + BUSY_S
        assert run.wait(PATIENCE_S) == 1


@pytest.mark.release
def test_the_others_stop_when_a_robot_of_another_vendors_dds_is_killed(lab, witness):
    with (
        witnessed(lab, witness) as processes,
        started(lab, *run_words(*LONG, "--out", "logs"), output="run.txt") as run,
    ):
        assert drives(lab, run), (lab / "run.txt").read_text()
        processes["blue"].send_signal(signal.SIGKILL)
        assert run.wait(PATIENCE_S) == 1 and "blue" in (lab / "run.txt").read_text()
        others = [name for name in ROBOTS if name != "blue"]
        assert wait_for(
            CLOCK, lambda: None not in [stood_ns(lab)[name] for name in others], PATIENCE_S
        )
