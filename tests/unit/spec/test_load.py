"""Tests of specs: each problem is one line at its place, and values are loaded as written."""

import hashlib
import itertools
import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from testkit.paths import ROOT, SPECS
from testkit.trials import experiment

from tetractl.core.errors import Exit, SpecError
from tetractl.core.trial import RESERVED_FILE_NAMES
from tetractl.log.format import channels
from tetractl.spec.consistency import SpecFinding
from tetractl.spec.identified import Identified, IdentifiedRobot, IdentifiedValue, merge_identified
from tetractl.spec.load import load_spec, parse_resolved, parse_spec
from tetractl.spec.loaded_spec import attach_file, resolved_yaml, spec_hash
from tetractl.spec.yaml.document import parse_document
from tetractl.spec.yaml.problems import InvalidSpecError
from tetractl.spec.yaml.settings import FieldValue

EXPERIMENTS = ROOT / "experiments"
GOOD = """\
name: good
arena: {left: 0, bottom: 0, width: 100, height: 100}
robots:
  - {name: one, start: [10, 10], target: [90, 90], a: 3, speed: 20}
  - {name: two, start: [10, 20], target: [90, 80], a: 4, speed: 20}
obstacles:
  - {type: rectangle, left: 40, bottom: 40, width: 10, height: 10}
  - {type: circle, center: [60, 20], radius: 5}
controller:
  type: pso-mpc
  optimizer:
    stop: {type: target, cost: 5}
    particles: 5
"""


def problems(text, *sets):
    with pytest.raises(InvalidSpecError) as caught:
        parse_spec(text, "s.yaml", sets)
    assert caught.value.exit == Exit.USAGE
    return caught.value.message.splitlines()


def changed(old, new):
    assert old in GOOD
    return GOOD.replace(old, new, 1)


def joined(table):
    """Return a table of cases with its broken lines joined."""
    return table.replace("\n    ", " ").replace("(nothing)", "")


PROBLEMS = r"""
start: [10, 10] -> headng: 0, start: [10, 10]
  s.yaml:4:17: robots.0.headng: unknown key; did you mean 'heading'?
controller:\n -> controller:\n  motoin: exact\n
  s.yaml:10:3: controller.motoin: unknown key; did you mean 'motion'?
controller:\n -> controller:\n  particles: 3\n
  s.yaml:10:3: controller.particles: unknown key here; did you mean
    'controller.optimizer.particles'?
cost: 5 -> cost: 5, frobnicate: 5
  s.yaml:12:35: controller.optimizer.stop.frobnicate: unknown key; known here: type, cost
type: circle, -> type: circle, circle: 3,
  s.yaml:8:20: obstacles.1.circle: unknown key; known here: type, center, radius
a: 3 -> a: -3
  s.yaml:4:55: robots.0.a: -3: must be greater than 0
speed: 20 -> speed: -20
  s.yaml:4:65: robots.0.speed: -20: must be at least 0
a: 3 -> a: .nan
  s.yaml:4:55: robots.0.a: .nan: must be a finite number
a: 3 -> a: 1e999
  s.yaml:4:55: robots.0.a: 1e999: must be a finite number
a: 3 -> a: on
  s.yaml:4:55: robots.0.a: on: must be a number
a: 3 -> a: true
  s.yaml:4:55: robots.0.a: true: must be a number
a: 3 -> a: '3'
  s.yaml:4:55: robots.0.a: '3': must be a number; take the quotes away
a: 3 -> a:
  s.yaml:4:54: robots.0.a: has no value; must be a number
a: 3 -> a: [3]
  s.yaml:4:55: robots.0.a: [3]: must be a number
particles: 5 -> particles: 5.5
  optimizer.particles: 5.5: must be a whole number
particles: 5 -> particles: 0
  optimizer.particles: 0: must be at least 1
[10, 10] -> [10]
  s.yaml:4:24: robots.0.start: [10]: must have 2 entries
[10, 10] -> [1, 2, 3]
  robots.0.start: [1, 2, 3]: must have at most 2 entries, not 3
[10, 10] -> [10, 10, 0.5]
  has a point, not a comma; a heading is a field of its own, heading: 0.5
[10, 10] -> 10
  s.yaml:4:24: robots.0.start: 10: must be a list of 2 numbers: start position [x, y] [length unit]
[10, 10] -> [10, ten]
  s.yaml:4:29: robots.0.start.1: ten: must be a number
name: good -> name: 5
  s.yaml:1:7: name: 5: must be text; put it in quotes
name: good -> name: a/b
  s.yaml:1:7: name: a/b: must be letters without accents (a to z, A to Z), digits, dots,
    underscores and hyphens, starting with a letter or digit
controller:\n -> controller:\n  motion: exactt\n
  s.yaml:10:11: controller.motion: exactt: must be one of euler, exact; did you mean 'exact'?
type: rectangle -> type: rectangel
  s.yaml:7:12: obstacles.0.type: rectangel: must be one of rectangle, circle, polygon; did you
    mean 'rectangle'?
type: rectangle,  -> (nothing)
  s.yaml:7:5: obstacles.0.type: is missing; must be one of rectangle, circle, polygon
, a: 3 -> (nothing)
  s.yaml:4:5: robots.0.a: is missing; add it: turning rate a towards the common direction
    [rad/s], in the paper's equation (3)
obstacles:\n -> plant: {camera_rate: 120, truth_rate: 60}\nobstacles:\n
  s.yaml:6:39: plant.truth_rate: 60: must be at least as high as camera_rate, 120
obstacles:\n -> plant: {type: sim, truth_rate: 60}\nobstacles:\n
  s.yaml:6:32: plant.truth_rate: 60: must be at least as high as camera_rate, 120
start: [10, 10] -> start: [45, 50]
  s.yaml:4:24: robots.0.start: [45, 50]: is inside obstacles.0, a rectangle; move one of them
target: [90, 80] -> target: [63, 22]
  s.yaml:5:42: robots.1.target: [63, 22]: is inside obstacles.1, a circle; move one of them
target: [90, 80] -> target: [190, 80]
  s.yaml:5:42: robots.1.target: [190, 80]: is outside the arena; it must be within x 0 to 100, y
    0 to 100
left: 40 -> left: 140
  s.yaml:7:5: obstacles.0: is entirely outside the arena, which is x 0 to 100, y 0 to 100
center: [60, 20] -> center: [104, 104]
  s.yaml:8:5: obstacles.1: is entirely outside the arena, which is x 0 to 100, y 0 to 100
name: two -> name: one
  s.yaml:5:12: robots.1.name: one: is already the name of robots.0; names must differ
type: target, cost: 5 -> type: 3
  stop.type: 3: must be one of paper, relative
{type: target, cost: 5} -> paper
  stop: paper: must be a mapping of keys to values
"""  # what is replaced in GOOD, and the line that says so


@pytest.mark.parametrize("case", re.findall(r"(.*) -> (.*)\n  (.*)\n", joined(PROBLEMS)))
def test_each_problem_is_one_line_at_its_place(case):
    old, new, line = case
    text = changed(old.replace("\\n", "\n"), new.replace("\\n", "\n"))
    (problem,) = problems(text)
    assert line in problem


def test_all_problems_are_reported_at_once_in_the_order_of_lines():
    text = """\
name: good
name: twice
units: {length: mn}
arena: {left: 0, bottom: 0, width: 100, height: 100}
robots:
  - {name: one, start: [10, 10], target: [90, 190], a: 3, speed: 20}
  - {name: one, start: [10, 20], target: [90, 80], a: !!set {}, speed: 20}
  - {name: one, start: [10, 20], target: [90, 80], a: 3, sped: 20}
trials: {count: 2.5}
controler: {}
"""
    assert [line.split(": ")[:2] for line in problems(text)] == [
        ["s.yaml:2:1", "name"],
        ["s.yaml:3:17", "units.length"],
        ["s.yaml:7:55", "robots.1.a"],
        ["s.yaml:8:5", "robots.2.speed"],
        ["s.yaml:8:58", "robots.2.sped"],
        ["s.yaml:9:17", "trials.count"],
        ["s.yaml:10:1", "controler"],
    ]


@pytest.mark.long
def test_thousands_of_problems_are_cut_short():
    unknown_keys = "".join(f"key{i}: 1\n" for i in range(500))
    *first_hundred, last = problems(GOOD + unknown_keys)
    assert len(first_hundred) == 100
    assert last == "s.yaml: there are more problems; correct these first"


SETTINGS = """
controller.optimizer.particle=200
  controller.optimizer.particle: unknown key; did you mean 'particles'?
controler.period=1
  controler: unknown key; did you mean 'controller'?
particles=3
  did you mean 'controller.optimizer.particles'?
robots.0.a=-5
  robots.0.a: -5: must be greater than 0
robots.two.start=[200, 1]
  robots.1.start: [200, 1]: is outside the arena
robots.2.a=5
  robots: has no entry '2'; its entries are 0 to 1 or one, two
robots.0.start.7=5
  robots.0.start: has no entry '7'; its entries are 0 to 1
name.x=5
  name: has no 'x', because it is a single value
robots
  must have the form PATH=VALUE
=5
  must have the form PATH=VALUE
controller.horizon_max=1e22
  1e22: must be a whole number
a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a=1
  the path has more than 32 parts
controller..period=5
  controller: a part of the path is empty
trials={count: 1
  not valid YAML
trials.count=
  trials.count: has no value; must be a whole number
trials.count=!!set {}
  trials.count: the tag !!set does not fit
trials={cnt: 3}
  trials.cnt: unknown key; did you mean 'count'?
controller.first_plan={type: square}
  controller.first_plan: unknown key
"""


@pytest.mark.parametrize(("setting", "line"), re.findall(r"(.*)\n  (.*)\n", joined(SETTINGS)))
def test_problems_of_settings_name_the_setting(setting, line):
    (problem,) = problems(GOOD, setting)
    assert problem.startswith(f"--set {setting}: ")
    assert line in problem


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        (
            "controller.period=1e6",
            "gives 1.92e+09 poses in each control period of 1e+06 s, but at most 2e+06 are allowed",
        ),
        (
            "controller.optimizer={type: pso, particles: 1000000}",
            "controller: a control step would need about 1.7 GB of memory, more than 1",
        ),
    ],
)
def test_what_would_not_fit_into_memory_is_refused(setting, message):
    (problem,) = problems(GOOD, setting)
    assert message in problem


def test_settings_replace_values():
    sets = [
        "controller.optimizer.particles=200",
        "robots.0.a=5",
        "robots.two.a=1e1",
        "controller.optimizer.stop={type: budget}",
        "plant.measurement_noise.position=2",
        "robots.0.start.1=12",
        "obstacles=[]",
        "description='a: b'",
    ]
    experiment = parse_spec(GOOD, "s.yaml", sets).experiment
    assert experiment.controller.optimizer.particles == 200
    assert [robot.a for robot in experiment.robots] == [5, 10]
    assert experiment.controller.optimizer.stop.type == "budget"
    assert experiment.plant.measurement_noise.position == 2
    assert experiment.robots[0].start == (10, 12)
    assert experiment.obstacles == ()
    assert experiment.description == "a: b"


@pytest.mark.parametrize(
    ("controller", "settings", "dead_time_s"),
    [
        ("estimate: false", (), 0.1 + 0.03),
        ("estimate: true", (), 0.1),
        ("{}", (), 0.1),
        ("{}", ("controller.estimate=false",), 0.1 + 0.03),
        ("type: pso-mpc", (), 0.1 + 0.03),
    ],
    ids=["given", "estimated", "by default", "by a setting", "published"],
)
def test_an_identified_dead_time_counts_from_the_frame_where_none_is_estimated(
    controller, settings, dead_time_s, tmp_path
):
    """Regression: only an `estimate: true` written in the spec counted, not the default."""
    arena, _, _ = GOOD.partition("controller:")
    spec = tmp_path / "s.yaml"
    spec.write_text(f"{arena}controller: {{{controller.strip('{}')}}}\nidentified: found.yaml\n")
    found = "identified: now\norigin: lab\nunit: mm\ndead_time: {value: 0.1}\nframe_age: 0.03\n"
    (tmp_path / "found.yaml").write_text(f"{found}robots: {{}}\n")
    loaded = load_spec(spec, settings)
    assert loaded.experiment.controller.dead_time == pytest.approx(dead_time_s)


def test_a_loaded_spec_keeps_the_text_as_written(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_bytes(GOOD.replace("\n", "\r\n").encode())
    loaded = load_spec(path, ["trials.count=3"])
    assert loaded.text == GOOD.replace("\n", "\r\n")
    assert loaded.name == "s.yaml"
    assert loaded.path == path
    assert loaded.experiment == parse_spec(GOOD, "s.yaml", ["trials.count=3"]).experiment


@pytest.mark.parametrize("path", SPECS, ids=lambda path: path.stem)
def test_shipped_experiments_load_and_round_trip(path):
    spec = load_spec(path)
    experiment = spec.experiment
    assert parse_spec(resolved_yaml(experiment), "resolved").experiment == experiment
    assert path.read_text().startswith("# yaml-language-server: $schema=experiment.schema.json\n")
    assert experiment.name == path.stem.replace("_", "-")


@pytest.mark.parametrize("name", ["three_m3pi.yaml", "three_m3pi_paper.yaml"])
def test_the_reference_experiment_is_that_of_section_v(name):
    experiment = load_spec(EXPERIMENTS / name).experiment
    rows = [(*robot.start, *robot.target, robot.a, robot.speed) for robot in experiment.robots]
    assert rows == [
        (900, 800, 1700, 500, 6, 180),
        (900, 1200, 1700, 1500, 4, 200),
        (900, 1600, 1700, 2000, 3, 150),
    ]
    (box,) = experiment.obstacles
    assert (box.left, box.bottom, box.width, box.height) == (1200, 1100, 200, 200)
    assert (experiment.arena.width, experiment.arena.height) == (1600, 1800)
    assert experiment.controller.problem(experiment.setup).period == pytest.approx(0.2)
    reference = experiment.reference
    assert (reference.n, reference.mean, reference.std) == (20, 648.6, 225.1)


def hash_of(text, *sets):
    return spec_hash(parse_spec(text, "s.yaml", sets).experiment)


def test_the_hint_of_an_error_is_printed(monkeypatch):
    """Regression: only that of a warning was."""
    finding = SpecFinding(("robots", 0, "speed"), "is odd", "choose another")
    monkeypatch.setattr("tetractl.spec.load.find_errors", lambda *_: [finding])
    said = r"robots\.0\.speed: [0-9.]+: is odd; choose another$"
    with pytest.raises(InvalidSpecError, match=said):
        load_spec(ROOT / "experiments/three_m3pi.yaml")


def test_the_hash_does_not_follow_how_a_spec_is_written():
    with_defaults = GOOD.replace("a: 3", "a: 3.0") + "trials: {seed: 1, count: 20}\n"
    assert hash_of("# a comment\n" + with_defaults) == hash_of(GOOD)
    assert hash_of(GOOD, "arena.left=0.0") == hash_of(GOOD)
    assert hash_of(GOOD, "arena.left=-0.0") == hash_of(GOOD)


def test_files_of_several_folders_are_attached_by_their_names():
    robots = attach_file((), Path("a/robots.yaml"), "text of robots")
    two_files = attach_file(robots, Path("b/cameras.yaml"), "text of cameras")
    assert dict(two_files) == {"robots.yaml": "text of robots", "cameras.yaml": "text of cameras"}


@pytest.mark.parametrize("name", ["robots.yaml", *sorted(RESERVED_FILE_NAMES)])
def test_a_file_with_the_name_of_one_there_is_cannot_be_attached(name):
    robots = attach_file((), Path("a/robots.yaml"), "text of robots")
    with pytest.raises(SpecError, match=f"b/{name}: every log already has a file named {name}"):
        attach_file(robots, Path("b") / name, "another text")


def with_free_targets(starts, targets):
    """An experiment of robots, any of which may go to any target."""
    robots = []
    for i in range(len(starts)):
        robot = {"name": f"r{i}", "start": starts[i].tolist(), "target": targets[i].tolist()}
        robots.append(robot | {"a": 2 + i, "speed": 100})
    return experiment(robots=robots, obstacles=[], assign="free")


def sum_of_squares(starts, targets):
    return np.square(starts - targets).sum()


def in_some_order(points):
    return sorted(points.tolist())


def test_free_targets_are_dealt_out_by_the_least_squares_of_the_paths():
    rng = np.random.default_rng(4)
    for _ in range(5):
        starts, targets = rng.uniform(200, 1800, (2, 4, 2))
        dealt = with_free_targets(starts, targets).setup.targets
        assert in_some_order(dealt) == in_some_order(targets)
        orders = itertools.permutations(range(4))
        least = min(sum_of_squares(starts, targets[list(order)]) for order in orders)
        assert sum_of_squares(starts, dealt) == pytest.approx(least)


def test_the_hash_of_a_log_is_that_of_its_experiment():
    good = parse_spec(GOOD, "s.yaml").experiment
    assert parse_resolved(resolved_yaml(good), "s.yaml").hash == spec_hash(good)


def test_the_hash_of_an_earlier_log_is_that_of_the_keys_in_its_resolved_spec():
    """Regression: a field with a default that was added later failed `verify` of every log."""
    good = parse_spec(GOOD, "s.yaml").experiment
    earlier = yaml.safe_load(resolved_yaml(good))
    del earlier["plant"]["heading_noise"]
    del earlier["robots"][0]["via"]
    loaded = parse_resolved(yaml.safe_dump(earlier), "s.yaml")
    assert loaded.experiment == good
    assert loaded.hash != spec_hash(good)
    fields = json.dumps(earlier, sort_keys=True, separators=(",", ":"))
    assert loaded.hash == hashlib.sha256(fields.encode()).hexdigest()


def test_obstacles_that_reach_into_the_arena_are_fine():
    parse_spec(changed("left: 40", "left: -5"), "s.yaml")
    parse_spec(changed("center: [60, 20]", "center: [103, 103]"), "s.yaml")


WITHOUT_ROBOTS = "name: x\narena: {left: 0, bottom: 0, width: 9, height: 9}\n"


def test_a_list_of_bad_entries_is_not_called_too_short():
    (problem,) = problems(WITHOUT_ROBOTS + "robots: [3]\n")
    assert problem == "s.yaml:3:10: robots.0: 3: must be a mapping of keys to values"


def test_an_empty_list_is_called_too_short():
    (problem,) = problems(WITHOUT_ROBOTS + "robots: []\n")
    assert problem == "s.yaml:3:9: robots: []: must have at least 1 entries"


def test_control_characters_are_not_printed():
    (problem,) = problems(GOOD + '"\\e[31m\\n": 1\n')
    assert "\\x1b[31m\\n: unknown key" in problem


def test_a_setting_mends_a_bad_value_of_the_file():
    text = changed("a: 3", "a: !!set {x}")
    assert parse_spec(text, "s.yaml", ["robots.0.a=7"]).experiment.robots[0].a == 7


def test_problems_of_the_file_and_of_settings_come_together():
    lines = problems(changed("a: 3", "a: -3"), "trials.count=x", "nonsense")
    assert [line.split(": ")[0] for line in lines] == [
        "s.yaml:4:55",
        "--set nonsense",
        "--set trials.count=x",
    ]


def test_the_letter_of_the_paper_and_what_we_recommend_differ_in_controller_and_watchdog_alone():
    paper = load_spec(EXPERIMENTS / "three_m3pi_paper.yaml").experiment
    ours = load_spec(EXPERIMENTS / "three_m3pi.yaml").experiment
    assert paper.controller.optimizer.stop.type == "paper"
    assert paper.controller.motion == "euler"
    same = {"name": paper.name, "controller": paper.controller, "wheels": paper.wheels}
    assert ours.wheels.model_copy(update={"watchdog": None}) == paper.wheels
    assert ours.model_copy(update=same) == paper


def test_the_hash_is_one_of_sha_256():
    assert re.fullmatch("[0-9a-f]{64}", hash_of(GOOD))


@pytest.mark.parametrize(
    "setting", ["trials.seed=2", "robots.0.a=3.0000001", "controller.optimizer.stop.cost=6"]
)
def test_the_hash_follows_the_experiment(setting):
    assert hash_of(GOOD, setting) != hash_of(GOOD)


def test_the_files_that_every_log_has_are_those_of_its_channels():
    of_channels = {channels.SPEC, channels.RESOLVED_SPEC, channels.ENVIRONMENT, channels.LAYOUT}
    assert of_channels == RESERVED_FILE_NAMES


def test_targets_that_were_dealt_out_are_given():
    starts, targets = np.random.default_rng(4).uniform(200, 1800, (2, 4, 2))
    dealt = with_free_targets(starts, targets)
    assert dealt.assign == "given"
    assert type(dealt).model_validate(dealt.model_dump()) == dealt


def test_the_number_of_an_option_stays_a_number():
    seeded = parse_spec(GOOD, "s.yaml", [FieldValue("trials.seed", 3, "--seed")])
    assert seeded.experiment.trials.seed == 3


def test_an_error_of_an_option_names_the_option():
    with pytest.raises(InvalidSpecError) as caught:
        parse_spec(GOOD, "s.yaml", [FieldValue("trials.seed", -1, "--seed")])
    assert caught.value.message == "--seed -1: trials.seed: -1: must be at least 0"


def test_an_identified_value_goes_to_its_robot_also_behind_an_entry_that_is_none():
    document = parse_document("robots: [oops, {name: red, a: !!set {x}}]", "s.yaml")
    values = dict.fromkeys(IdentifiedRobot.model_fields, IdentifiedValue(value=4.0))
    robots = {"red": IdentifiedRobot(**values)}
    dead_time = IdentifiedValue(value=0.1)
    identified = Identified(
        identified="", origin="lab", unit="mm", dead_time=dead_time, robots=robots
    )
    merge_identified(document, identified, "found.yaml", identifies_robots=True)
    assert document.data["robots"][1] == {"name": "red", "a": 4.0, "speed": 4.0}
    assert document.all_problems == []  # the a that could not be read is replaced
