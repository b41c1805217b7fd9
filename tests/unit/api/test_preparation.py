"""Tests of what happens before and around simulations that a script asks for."""

import logging
import threading

import pytest
from testkit.paths import ROOT

from tetractl.api.preparation import announcer, check_simulated, interruptible
from tetractl.core.errors import UsageError
from tetractl.spec.load import load_spec
from tetractl.spec.plants import select_plant

LAB = load_spec(ROOT / "experiments/three_m3pi_lab.yaml")


@pytest.fixture
def warmed(monkeypatch):
    """The experiments whose code is compiled; none really is."""
    experiments = []
    monkeypatch.setattr(
        "tetractl.control.methods.build.warm_up", lambda spec, announce: experiments.append(spec)
    )
    return experiments


def test_a_simulation_is_compiled_and_its_warnings_are_logged(warmed, monkeypatch, caplog):
    monkeypatch.setattr("tetractl.run.plausibility.find_warnings", lambda spec: ["a doubt"])
    with caplog.at_level(logging.WARNING):
        check_simulated(LAB, print)
    assert warmed == [LAB.experiment]
    assert [record.getMessage() for record in caplog.records] == ["warning: a doubt"]


def test_robots_in_a_lab_are_not_driven_by_a_script(warmed):
    with pytest.raises(UsageError, match="cannot drive robots in a lab") as caught:
        check_simulated(select_plant(LAB, "lab"), print)
    assert caught.value.hint == "use `tetractl run`"
    assert warmed == []


def test_compiling_is_printed_or_logged(capsys, caplog):
    announcer(True)("compiling")
    assert capsys.readouterr().err == "compiling\n"
    with caplog.at_level(logging.INFO, "tetractl"):
        announcer(False)("compiling")
    assert capsys.readouterr().err == ""
    assert [record.getMessage() for record in caplog.records] == ["compiling"]


@pytest.mark.parametrize("after", ["", "the others can be run later"])
def test_a_request_to_end_is_raised_after_the_block(after):
    reached = []
    with pytest.raises(KeyboardInterrupt) as caught, interruptible(after) as interrupt:
        interrupt.request()
        reached.append("the end of the block")
    assert reached
    assert caught.value.args == ((after,) if after else ())


def test_nothing_is_raised_without_a_request():
    with interruptible("x") as interrupt:
        assert not interrupt.requested


@pytest.mark.parametrize("in_main_thread", [True, False])
def test_only_the_main_thread_listens_to_signals(monkeypatch, in_main_thread):
    watched = []

    class Watching:
        requested = False

        def watch(self):
            watched.append(True)
            return self

        def __enter__(self):
            return self

        def __exit__(self, *_):
            return None

    monkeypatch.setattr("tetractl.run.interrupt.Interrupt", Watching)

    def block():
        with interruptible():
            pass

    if in_main_thread:
        block()
    else:
        thread = threading.Thread(target=block)
        thread.start()
        thread.join()
    assert bool(watched) is in_main_thread
