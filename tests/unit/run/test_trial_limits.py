from support.paths import ROOT

from tetractl.experiment.load import load_spec
from tetractl.experiment.plants import on_plant
from tetractl.run.trial_limits import limits

SPEC = ROOT / "experiments" / "three_m3pi_lab.yaml"


def test_a_dry_run_in_the_lab_says_where_it_would_go_and_what_ends_it():
    slow = [f"lab.actuator.robots.{i}.limit=20" for i in range(3)]
    found = limits(on_plant(load_spec(SPEC, slow), "lab").experiment)
    assert found["cameras"] == "192.168.1.10:1510, multicast"
    assert found["radio"] == "/dev/ttyUSB0, 40 commands per second"
    assert found["wheel counts"] == "at most 20 of 127"
    assert found["all robots stop"].startswith("0.1 s")
    assert "cameras" not in limits(load_spec(SPEC).experiment)
