"""Tests that each warning about a spec appears with its number, and not for a sound spec."""

import re
from copy import deepcopy

import numpy as np
import pytest
import yaml
from testkit.bounded import best_plan, spec
from testkit.paths import ROOT

from tetractl.core.registries import REGISTRIES
from tetractl.run.plausibility import (
    CheckContext,
    find_warnings,
    targets_beyond_plan,
    targets_out_of_reach,
)
from tetractl.spec.base import ANGLE_MARK, Model
from tetractl.spec.load import load_spec, parse_contents, parse_spec
from tetractl.spec.loaded_spec import resolved_yaml
from tetractl.spec.yaml.problems import InvalidSpecError

THREE = ROOT / "experiments" / "three_m3pi.yaml"
LAB = ROOT / "experiments" / "three_m3pi_lab.yaml"
BENCH = ROOT / "experiments" / "three_m3pi_bench.yaml"
ON = "wheels.watchdog=null"
BLOCK = "{{type: rectangle, left: 1200, bottom: {}, width: 100, height: {}}}".format
NAMED = {
    "LAB": LAB,
    "ON": ON,
    "NEAR": "controller.collision.radius=20",
    "PSO": "controller={type: pso-mpc, period: 0.2, steps_max: 100, horizon_max: 20}",
    "FIXED": "controller.collision.adaptive=false",
    "WALL": f"obstacles=[{BLOCK(0, 3000)}]",
    "GAP": f"obstacles=[{BLOCK(0, 1380)}, {BLOCK(1410, 2000)}]",
}


def found(path, *sets):
    """Warnings by field; three_m3pi.yaml is controlled at 5 Hz unless `sets` say otherwise."""
    slow = ("controller.period=0.2", "controller.signal_periods=1") if path == THREE else ()
    return {w.field: w for w in find_warnings(load_spec(path, (*slow, *sets)))}


PARALLEL = ["robots.blue.a=6", "robots.blue.target=[1700, 900.5]", "robots.blue.speed=180"]
FOUND = r"""
robots.2.heading <- robots.red.heading=90
  6.283 rad | write 1.571
robots.2.heading <- robots.red.heading=-7
  6.283 rad | write -0.1222
robots.0.a <- robots.green.a=360
  360 rad/s, .* within 0.0083 s | write 6.283
wheels.radius <- units.length=cm
  0.8 m apart | (units.length: cm)
robots.1.a <- robots.blue.a=6
  blue turns at the same rate as green .* cannot fall below 575.6 mm | turning rates a
robots.1.a <- robots.blue.a=5.9
  blue and green differ by only 1.7 % in turning rate a and 0 rad .* below 575.6 mm | rates a
robots.1.a <- robots.blue.a=6; robots.blue.heading=0.04
  0 % in turning rate a and 0.04 rad in start heading | turning rates a
robots <- robots.blue.a=6
  any plan is 575.6 mm | no controller
robots.0.target <- controller.time_limit=4.2; controller.horizon_max=20
  854.4 mm away, .* drives only 756 mm in the 4.2 s of a trial, 98.4 too little | time_limit
controller.horizon_max <- controller.horizon_max=20
  red is 894.4 mm from .* drives only 600 mm in 20 signals \(4 s\), 294.4 too little | more than 30
controller.horizon_max <- PSO
  red is 894.4 mm from .* drives only 600 mm in 20 signals \(4 s\), 294.4 too little | more than 30
controller.horizon_max <- controller.horizon_max=102; controller.time_limit=20.2
  plans of 20.4 s are longer than the trial, .* 20.2 s | horizon_max to 101
controller.horizon_max <- PSO; controller.steps_max=10
  plans of 4 s are longer than the trial, .* 2.2 s | steps_max, or lower horizon_max to 11
robots.1.target <- WALL
  walled off: .* closer than 49\d | gap
robots.1.target <- GAP; NEAR
  be reached by a path that keeps 20 mm .* within 51\d | margin
robots.1.target <- robots.blue.target=[1420, 1200]; NEAR; controller.collision.margin=5; FIXED
  is 20 mm from the .* or wall, but the controller's plans keep a distance of 25 mm | margin
robots.1.target <- robots.blue.target=[1420, 1200]; NEAR
  leaves only 0 mm of free space .* drives 40 mm in a control period | move the target
robots.1.target <- robots.blue.target=[2075, 1500]; controller.period=0.05; NEAR
  leaves only 5 mm of free space .* drives 10 mm in a control period | move the target
controller.accept_error <- controller.accept_error=4; controller.prior.position_noise=2
  is less than 0.7 x position_noise x number of robots, 4.2 mm | set it to 4.2 mm or more
controller.period <- controller.period=0.4; controller.motion=euler; ON
  for green: .* is 2.4, above 2: .* equation \(6\) of the paper, its heading | less than 0.333 s
controller.period <- controller.period=0.6; ON
  for green: .* is 3.6, .* 2 robots complete 90.9 % or more | less than 0.333 s
controller.period <- LAB; controller.signal_periods=14
  for green: its turning rate a times T is 4.2, .* 3 robots complete 87.8 % or more | 0.333 s
plant.dead_time <- plant.dead_time=0.3; controller.estimate=false
  is 0.3 s, but the controller assumes 0 s, .* 1.5 control periods | controller.dead_time to 0.3
robots.1.start <- LAB; robots.blue.start=[900, 895]
  is 95 mm from the start of green, but .* 110 mm | lab.limits.separation_mm
robots.1.target <- LAB; robots.blue.target=[1700, 595]
  is 95 mm from the target of green | apart
"""  # a field, the settings by which it is warned of, the message and the hint


@pytest.mark.parametrize("case", re.findall(r"(.*) <- (.*)\n  (.*) \| (.*)\n", FOUND))
def test_each_is_found_at_its_field_with_its_number(case):
    field, settings, message, hint = case
    sets = [NAMED.get(setting, setting) for setting in settings.split("; ")]
    path = sets.pop(0) if sets[0] == LAB else THREE
    warning = found(path, *sets)[field]
    assert re.search(message, warning.message), warning.message
    assert hint in warning.hint


@pytest.mark.parametrize(
    "sets",
    [
        ["robots.red.heading=6.28"],
        ["robots.blue.a=6", "robots.blue.target=[1700, 900]", "robots.blue.speed=180"],
        [*PARALLEL, "controller.arrival_tolerance=1"],  # less than a robot may be off
        ["robots.blue.a=6", "robots.blue.heading=0.5"],
        ["robots.blue.a=5.6"],
        ["controller.horizon_max=101"],
        ["controller.period=0.3", "controller.motion=euler", ON],
        ["controller.period=0.4", ON],
        ["plant.dead_time=0.2"],
        ["plant.dead_time=0.3", "controller.dead_time=0.25"],
        ["obstacles=[]"],
        ["controller.accept_error=4.3", "controller.prior.position_noise=2"],
        ["robots.blue.start=[900, 895]"],
    ],
)
def test_what_is_only_near_a_warning_is_none(sets):
    assert found(THREE, *sets) == {}


def test_the_lab_is_judged_in_millimetres_whatever_the_unit():
    text = LAB.read_text("utf-8").replace("length: mm", "length: cm")
    text = text.replace("radius: 47", "radius: 3.9")
    warnings = find_warnings(parse_spec(text, "cm"))
    assert all("start" not in warning.field for warning in warnings)  # 400 cm apart
    close = find_warnings(parse_spec(text.replace("[900, 1200]", "[900, 808]"), "cm"))
    (start,) = [warning for warning in close if warning.field == "robots.1.start"]
    assert "is 80 mm from the start of green" in start.message


def test_a_warning_stands_at_its_line_or_at_its_setting():
    text = THREE.read_text("utf-8").replace(
        "heading: 0, target: [1700, 2000]", "heading: 90, target: [1700, 2000]"
    )
    (warning,) = find_warnings(parse_spec(text, "s.yaml"))
    line = text[: text.index("heading: 90")].count("\n") + 1
    assert str(warning).startswith(f"s.yaml:{line}:")
    assert ": robots.2.heading: 90: is more than" in str(warning)
    (set_,) = found(THREE, "robots.red.heading=90").values()
    assert str(set_).startswith("--set robots.red.heading=90: robots.2.heading: 90: ")


def test_a_warning_of_an_identified_value_names_the_file_that_states_it(tmp_path):
    """Regression: it quoted the spec's value, which the file replaces."""
    values = ("speed", "heading_bias", "position_noise", "heading_noise", "heading_walk")
    robot = ", ".join(f"{name}: {{value: 180}}" for name in values)
    (tmp_path / "m.yaml").write_text(
        "identified: now\norigin: lab\nunit: mm\ndead_time: {value: 0.1}\n"
        f"robots: {{green: {{a: {{value: 90}}, {robot}}}}}\n"
    )
    spec = tmp_path / "s.yaml"
    spec.write_text(f"{THREE.read_text('utf-8')}\nidentified: m.yaml\n")
    (warning,) = [w for w in find_warnings(load_spec(spec)) if w.field == "robots.0.a"]
    assert str(warning).startswith(f"{tmp_path / 'm.yaml'}: robots.0.a: is 90 rad/s")


SAME = """
name: same
arena: {left: 0, bottom: 0, width: 100, height: 100}
robots:
  - {name: one, start: [10, 10], target: [90, 90], a: 4, speed: 10}
  - {name: two, start: [10, 13], target: [90, 94], a: 2, speed: 10}
  - {name: three, start: [10, 10], target: [90, 90], a: 1, speed: 10}
"""


def test_robots_at_one_place_are_told():
    warnings = list(map(str, find_warnings(parse_spec(SAME, "s"))))
    of_places = [line for line in warnings if "stand there" in line]
    assert [line.partition(", so that")[0] for line in of_places] == [
        "s:7:26: robots.2.start: [10, 10]: is 0 mm from the start of one",
        "s:7:44: robots.2.target: [90, 90]: is 0 mm from the target of one",
    ]


APART = SAME.replace("three, start: [10, 10], target: [90, 90]", "three, start: [50, 50]").replace(
    "{name: three, start: [50, 50]", "{name: three, start: [50, 50], target: [20, 20]"
)
"""The same robots, of which the targets of one and two are 4 mm apart, and the starts 3 mm."""


@pytest.mark.parametrize(
    ("text", "sets", "line"),
    [
        (
            SAME.replace("three, start: [10, 10]", "three, start: [11, 10]"),
            ("controller.collision.radius=1", "robots.three.target=[9, 9]"),
            "s:7:26: robots.2.start: [11, 10]: is 1 mm from the start of one: bodies of radius 1",
        ),
        (
            APART,
            ("controller.collision.radius=2.1", "robots.two.start=[1, 90]"),
            "s:6:42: robots.1.target: [90, 94]: is 4 mm from the target of one: bodies of "
            "radius 2.1",
        ),
    ],
    ids=["starts", "targets"],
)
def test_bodies_overlap_at_no_start_and_no_target(text, sets, line):
    with pytest.raises(InvalidSpecError) as caught:
        parse_spec(text, "s", sets)
    assert caught.value.lines() == [f"{line} overlap; move one of them"]


@pytest.mark.parametrize(
    "sets",
    [
        ["controller.collision.radius=2", "robots.two.start=[1, 90]"],  # they touch
        ["controller.collision.radius=1.5"],  # so do the starts
        # 2 x 2.5 mm apart but for rounding
        [
            "controller.collision.radius=2.5",
            "robots.two.target=[93, 94]",
            "robots.two.start=[1,90]",
        ],
        ["controller.collision.radius=0", "robots.two.target=[90, 90]"],  # points
        # one's target is where another starts, and a way-point of a third that it has left by then
        ["controller.collision.radius=1.5", "robots.three.target=[10, 10]"],
        [
            "controller.collision.radius=1.5",
            "robots.one.via=[[30, 30]]",
            "robots.two.via=[[60, 60]]",
            "robots.three.via=[[90, 90]]",
        ],
        # plans keep more from each other than bodies need
        ["controller.collision.radius=1.5", "controller.collision.separation=20"],
    ],
)
def test_bodies_may_touch_at_targets_and_come_to_one_place_one_after_the_other(sets):
    parse_spec(APART, "s", sets)


BODIES = ("controller.collision={radius: 47}", "controller.period=0.05")
"""Robots of 94 mm that drive up to 10 mm in a control period: 94 + 2 x 0.75 x 10 = 109 mm."""


@pytest.mark.parametrize(
    ("y", "told"), [(594.5, True), (608.9, True), (609.1, False), (1500, False)]
)
def test_targets_where_bodies_might_touch_are_told(y, told):
    sets = (*BODIES, f"robots.blue.target=[1700, {y}]")
    warnings = [w for w in found(THREE, *sets).values() if "might touch" in w.message]
    assert [w.field for w in warnings] == ["robots.1.target"] * told
    assert all(" keeps them 109 mm apart" in w.message for w in warnings)


@pytest.mark.parametrize(("x", "fits"), [(1419, False), (1420, True)])
def test_a_target_at_which_a_body_would_be_in_an_obstacle_is_refused(x, fits):
    # the obstacle's right side is at 1400 mm, and bodies have a radius of 20 mm
    sets = ("controller.collision.radius=20", f"robots.blue.target=[{x}, 1200]")
    if fits:
        load_spec(THREE, sets)
        return
    with pytest.raises(
        InvalidSpecError, match="is 19 mm from the nearest obstacle or edge: a body"
    ):
        load_spec(THREE, sets)


def test_a_target_over_the_edge_is_refused_where_plans_keep_to_the_walls():
    sets = ("controller.collision.radius=20", "robots.red.target=[1700, 2140]")
    with pytest.raises(InvalidSpecError, match="edge: a body of radius 20 does not fit there"):
        load_spec(THREE, sets)
    load_spec(THREE, (*sets, "controller.collision.walls=false"))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("big", ["1.0e+308", "1.0e+160", "1.0e-290"])
def test_numbers_at_the_end_of_floating_point_break_nothing(big):
    text = f"""
name: big
arena: {{left: -{big}, bottom: -{big}, width: {big}, height: {big}}}
robots:
  - {{name: a, start: [-{big}, -{big}], target: [0, 0], a: {big}, speed: {big}}}
  - {{name: b, start: [0, 0], target: [0, -{big}], a: {big}, speed: 0, heading: 1.0e+300}}
  - {{name: c, start: [0, 0], target: [0, -{big}], a: 1.0e-300, speed: 1.0e-300}}
obstacles: [{{type: rectangle, left: -{big}, bottom: 0, width: 1.0e-320, height: 1.0e-320}}]
controller: {{type: mpc, period: 100, collision: {{margin: {big}}}}}
"""
    try:
        loaded = parse_spec(text, "big")
    except InvalidSpecError as error:  # products of such lengths are 0: all points touch
        assert "is inside obstacles.0" in str(error)
        assert float(big) < 1e-150
        return
    for warning in find_warnings(loaded):
        assert "\n" not in str(warning)


def test_what_the_optimiser_solves_is_never_called_out_of_reach():
    solved = set()
    warned = set()
    for seed in range(24):
        rng = np.random.default_rng(seed)
        experiment = spec(rng, robots=2, signals=int(rng.integers(10, 40)), kind="apart")
        case = CheckContext(experiment)
        if [*targets_out_of_reach(case), *targets_beyond_plan(case)]:
            warned.add(seed)
        if best_plan(experiment) < 1:
            solved.add(seed)
    assert len(solved) > 5
    assert len(warned) > 3
    assert not solved & warned


def test_a_warning_of_contents_names_no_line():
    """Regression: it named a line and a column of a file that there is not."""
    contents = yaml.safe_load(THREE.read_text("utf-8"))
    contents["robots"][2]["heading"] = 90
    (warning,) = find_warnings(parse_contents(contents, "spec"))
    assert str(warning).startswith("spec: robots.2.heading: 90: is more than")


@pytest.mark.parametrize("target", ["[4000, 1200]", "[1300, 1200]"])
def test_a_target_outside_the_arena_or_in_an_obstacle_has_one_message(target):
    """Regression: a second one said that it was -2300 mm from the nearest obstacle or edge."""
    sets = ("controller.collision.radius=20", f"robots.blue.target={target}")
    with pytest.raises(InvalidSpecError) as refused:
        load_spec(THREE, sets)
    assert len(refused.value.message.splitlines()) == 1


def numbers_in(value, loc=()):
    """Where the numbers of a spec's contents are."""
    if isinstance(value, dict):
        items = value.items()
    elif isinstance(value, list):
        items = enumerate(value)
    else:
        if isinstance(value, int | float) and not isinstance(value, bool):
            yield loc
        return
    for key, inner in items:
        yield from numbers_in(inner, (*loc, key))


def with_number(contents, loc, number):
    changed = deepcopy(contents)
    section = changed
    for key in loc[:-1]:
        section = section[key]
    section[loc[-1]] = number
    return changed


@pytest.mark.long
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("number", [1e17, -1e17, 1e300, 1.7e308, 1e-17, 1e-300])
def test_an_absurd_number_in_any_field_ends_in_one_line_each(number):
    """Regression: `arena.width: 1e17` was a traceback."""
    contents = yaml.safe_load(resolved_yaml(load_spec(BENCH).experiment))
    locs = list(numbers_in(contents))
    assert ("arena", "width") in locs
    for loc in locs:
        try:
            loaded = parse_contents(with_number(contents, loc, number), "absurd")
        except InvalidSpecError as error:
            lines = [str(problem) for problem in error.problems]
        else:
            lines = list(map(str, find_warnings(loaded)))
        assert not any("\n" in line for line in lines), loc


def sections(model):
    """All section classes derived from `model`, at any depth."""
    for section in model.__subclasses__():
        yield section
        yield from sections(section)


def test_every_field_in_radians_is_marked_as_an_angle():
    """A field without the mark would get no warning of an angle in degrees."""
    for registry in REGISTRIES:
        for name in registry.names():
            registry.load(name)
    unmarked = [
        f"{section.__name__}.{name}"
        for section in sections(Model)
        if not section.__module__.startswith("tetractl_emulator")  # scripts of faults, no specs
        for name, field in section.model_fields.items()
        if "[rad]" in (field.description or "") and ANGLE_MARK not in field.metadata
    ]
    assert (
        sorted(set(unmarked) - {"IdentifiedRobot.heading_bias", "IdentifiedRobot.heading_noise"})
        == []
    )


def test_warnings_come_in_the_order_of_their_lines():
    warnings = found(THREE, "controller.time_limit=2.2", "robots.red.heading=90").values()
    lines = [warning.line for warning in warnings if warning.line]
    assert len(lines) > 3
    assert lines == sorted(lines)
    assert next(reversed(warnings)).line is None


def test_very_many_robots_alike_are_one_line():
    names = "".join(
        f"  - {{name: r{i}, start: [{i}, 0], target: [{i * i % 97}, 90], a: 4, speed: 100}}\n"
        for i in range(90)
    )
    text = f"name: many\narena: {{left: 0, bottom: 0, width: 100, height: 100}}\nrobots:\n{names}"
    fields = [w.field for w in find_warnings(parse_spec(text, "many"))]
    assert fields == ["robots", "robots.1.a", "robots.49.target"]


def refused(text, *sets):
    """The lines of the error by which a spec is refused."""
    with pytest.raises(InvalidSpecError) as caught:
        parse_spec(text, "s", sets)
    return caught.value.lines()


def test_bodies_overlap_at_no_way_points_that_robots_pass_together():
    vias = ["robots.one.via=[[30, 30]]", "robots.two.via=[[30, 32]]", "robots.three.via=[[60, 60]]"]
    (line,) = refused(APART, "controller.collision.radius=1.5", *vias)
    assert "robots.1.via.0: [[30, 32]]: is 2 mm from the way-point of one: bodies of" in line


@pytest.mark.parametrize("fixed", ["adaptive=false", "separation=0"])
def test_robots_that_are_led_there_all_the_same_are_not_told(fixed):
    sets = (*BODIES, "robots.blue.target=[1700, 600]", f"controller.collision.{fixed}")
    assert not any("might touch" in w.message for w in found(THREE, *sets).values())


@pytest.mark.parametrize(
    "change",
    [
        "robots.green.a=25.1",  # a microjet at 2 mT, the fastest published
        "robots.green.a=60",
        "wheels.radius=13.3",  # toio
        "wheels.radius=130",  # iRobot Create
        "wheels.radius=270",  # the largest robots of laboratories
    ],
)
def test_fast_robots_and_wheels_of_real_robots_are_believed(change):
    assert not {"robots.0.a", "wheels.radius"} & set(found(THREE, change))


IN_METRES = """
name: metres
units: {length: m}
arena: {left: 0, bottom: 0, width: 2, height: 2}
robots:
  - {name: green, start: [0.3, 0.4], target: [1.3, 0.5], a: 6, speed: 0.18}
wheels: {radius: 0.04}
plant: {type: sim}
"""


def test_the_same_robots_in_metres_are_believed():
    spec = parse_spec(IN_METRES, "metres")
    assert "wheels.radius" not in {warning.field for warning in find_warnings(spec)}
