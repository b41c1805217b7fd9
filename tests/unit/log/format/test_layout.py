"""Tests of the layout for log viewers: it names existing channels, and the arena fills the view."""

import json
import re
import shutil
import subprocess

import make_layouts
import pytest
from testkit.random_trials import trial, write
from testkit.trials import experiment

from tetractl.log.format import channels
from tetractl.log.format.layout import layout
from tetractl.log.read.reader import read_trial
from tetractl.log.read.salvage import scan


def layout_of(**changes):
    return json.loads(layout(experiment(**changes).setup))


def test_the_documented_layouts_are_what_is_written():
    for path, text in make_layouts.layouts().items():
        assert path.read_text("utf-8") == text, "run: python docs/make_layouts.py"


def test_every_path_leads_to_a_channel_and_every_panel_is_arranged():
    document = layout_of()
    panels = document["configById"]
    values = [curve["value"] for panel in panels.values() for curve in panel.get("paths", ())]
    paths = [value for value in values if value.startswith("/")]
    (script,) = document["userNodes"].values()
    computed = re.search(r'output = "(.*)"', script["sourceCode"])[1]
    fields = {
        f"{topic}.{name}"
        for topic, message in channels.CHANNELS.items()
        for field in message.DESCRIPTOR.fields
        for name in (field.name, *_inside(field))
    }
    for path in paths:
        assert path.startswith(f"{computed}.") or path.partition("[")[0] in fields
    assert set(panels["3D!arena"]["topics"]) <= set(channels.CHANNELS)
    arranged = re.findall(r"(?:3D|Plot)!\w+", json.dumps(document["layout"]))
    assert sorted(arranged) == sorted(panels)


def _inside(field):
    inner = field.message_type.fields if field.message_type else ()
    return [f"{field.name}.{inner_field.name}" for inner_field in inner]


def test_a_log_holds_its_layout(tmp_path):
    run = trial(steps=2, robots=3)
    path = write(run, tmp_path / "trial.mcap")
    assert scan(path).attachment_text(channels.LAYOUT) == layout(run.start.setup)
    assert read_trial(path).start.attached == run.start.attached


@pytest.mark.skipif(shutil.which("node") is None, reason="there is no node on this machine")
def test_the_script_computes_the_error():
    (script,) = layout_of()["userNodes"].values()
    source = re.sub(
        r"^import.*$|^type.*$| as unknown as \{.*?\}", "", script["sourceCode"], flags=re.M
    )
    source = re.sub(r"\(event: .*?\): Output", "(event)", source)
    source += "\nconst seen = {x: [1700, 1703, 1700], y: [500, 1504, 2000]};"
    source += "\nconsole.log(JSON.stringify(script({message: {observation: seen}})));"
    done = subprocess.run(
        ["node", "--input-type=module", "-e", source], capture_output=True, text=True, check=False
    )
    assert json.loads(done.stdout) == {"total": 5, "robots": [0, 5, 0]}, done.stderr
