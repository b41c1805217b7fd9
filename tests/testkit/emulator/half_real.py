"""Runs of a lab in which camera, actuator, both or neither are real, with checks of each."""

from testkit.emulator.lab_processes import SPEC, flags
from tetractl.log.read.reader import read_trial

OTHER = {"camera": "actuator", "actuator": "camera"}


def words_of(real, sets):
    """The command of a run, with its log in `logs`."""
    half = (f"plant.real={real}",) if real in OTHER else ()
    plant = "lab" if real == "both" else "emulated"
    words = ("--plant", plant, "--yes", "--quiet", "--out", "logs")
    return "run", SPEC, *words, *flags((*sets, *half))


def check_mix(folder, real, events):
    """Check a trial of a second and a half, and the events of the lab that plays the real part."""
    trial = read_trial(folder / "logs" / "trial-000.mcap")
    facts = trial.start.plant.facts
    names = [event["event"] for event in events]
    assert trial.result.outcome.value == "time limit"
    assert len(trial.steps) > 5
    ways_mm = abs(trial.mocap[-1, :, :2] - trial.mocap[0, :, :2]).sum(axis=1)
    assert (ways_mm > 50).all(), "the robots that are seen have driven"
    assert ("run" in names) == (real in ("actuator", "both"))
    assert ("client" in names) == (real in ("camera", "both"))
    if real in OTHER:
        assert facts["real"] == real
        assert facts["emulated"] == OTHER[real]
