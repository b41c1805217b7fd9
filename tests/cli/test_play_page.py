"""Tests of the page of `tetractl play --html`, played offline in a headless Chromium."""

import json
import re

import numpy as np
import pytest
from testkit.chromium import chromium, needs_chromium
from testkit.cli import tetractl
from testkit.paths import ROOT

import tetractl as package
from tetractl.report.play_page import play_page
from tetractl.run.hand import HandController, run_by_hand
from tetractl.run.open_trial import directed_spec
from tetractl.run.undisturbed import undisturbed_spec
from tetractl.spec.load import load_spec, parse_spec
from tetractl.view.terminal.hand_keys import read_key_script

pytestmark = pytest.mark.slow

PLAYABLE = (
    "five_robots",
    "five_robots_bench",
    "micro_channels",
    "round_obstacle",
    "single_cell",
    "tetrahymena",
    "tetrahymena_disturbed",
    "three_m3pi",
    "three_m3pi_bench",
    "three_m3pi_lab",
    "three_m3pi_measured",
    "three_m3pi_paper",
    "three_m3pi_paper_lab",
    "three_m3pi_paper_bench",
)
KEYS = [(0.0, "up"), (1.3, "right"), (2.05, "down"), (3.4, "left"), (4.45, "right"), (5.5, "space")]
SPEC = """
name: two-robots
arena: {left: 0, bottom: 0, width: 1000, height: 800}
robots:
  - {name: green, start: [300, 300], heading: 0.3, target: [700, 300], a: 6, speed: 100}
  - {name: red, start: [300, 500], heading: 0.3, target: [700, 500], a: 2, speed: 100}
obstacles: [{type: circle, center: [500, 650], radius: 50}]
controller: {type: pso-mpc, horizon_max: 8, steps_max: 40, period: 0.2,
  optimizer: {particles: 10, iterations: 5}}
plant: {type: sim, a_error: 0.1, heading_noise: 0.1, dead_time: 0.1}
"""


def page_of(spec):
    """Make the page of a spec with a controller's trial of one step, which takes no search."""
    undisturbed = undisturbed_spec(spec)
    return play_page(undisturbed, package.run_trial(directed_spec(undisturbed))).page


def world_of(page):
    """Read what a page knows of the experiment."""
    text = re.search(r'id="world">(.*?)</script>', page, re.DOTALL)
    assert text
    return json.loads(text[1])


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with chromium(tmp_path_factory.mktemp("profile")) as started:
        yield started


@pytest.fixture
def game(browser, tmp_path):
    """The page of SPEC in a browser, ready to be played."""
    show(browser, tmp_path, page_of(parse_spec(SPEC, "spec")))
    yield browser
    assert browser.errors == []


def show(browser, folder, page, width=1280, height=900):
    """Open a page and wait until it can be played."""
    file = folder / "play.html"
    file.write_text(page)
    browser.open(file, width, height)
    browser.run(
        "new Promise((done) => { const wait = () => window.game"
        " ? done() : setTimeout(wait, 5); wait(); })"
    )


def advance(game, seconds):
    """Let the robots drive, without the browser's own clock, in frames of 1/60 s."""
    game.run(
        f"(() => {{ game.clock.stop(); for (let t = 0; t < {seconds}; t += 1 / 60)"
        " game.advance(1 / 60); })()"
    )


def drag(game, start, end):
    """Drag the mouse from one point of the window to another [pixels]."""
    for kind, (x, y) in (("mousePressed", start), ("mouseMoved", end), ("mouseReleased", end)):
        buttons = 0 if kind == "mouseReleased" else 1
        button = {"button": "left", "buttons": buttons, "clickCount": 1}
        game.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **button)


def text(game, name):
    return game.run(f"document.getElementById('{name}').textContent")


@needs_chromium
def test_the_page_and_a_script_of_keys_end_at_the_same_poses(browser, tmp_path):
    """Of each shipped spec that can be played, without its disturbances, within 1e-6 mm."""
    file = tmp_path / "keys.txt"
    file.write_text("".join(f"{seconds} {key}\n" for seconds, key in KEYS))
    keys = read_key_script(file)
    for name in PLAYABLE:
        spec = load_spec(ROOT / "experiments" / f"{name}.yaml")
        directed = directed_spec(undisturbed_spec(spec))
        hand = HandController(directed, 0, keys.ask)
        result = run_by_hand(directed, tmp_path / name, hand)
        show(browser, tmp_path, page_of(spec))
        played = browser.run(f"runScript(game.world, {json.dumps(KEYS)}).poses")
        expected = np.column_stack([result.verdict.final.xy, result.verdict.final.heading])
        tolerance = 1e-6 * 1e-3 / spec.experiment.setup.metres  # 1e-6 mm
        np.testing.assert_allclose(
            np.array(played)[:, :2], expected[:, :2], rtol=0, atol=tolerance, err_msg=name
        )
    assert browser.errors == []


@pytest.mark.long
def test_every_shipped_spec_with_targets_alone_can_be_played():
    refused = []
    for file in sorted((ROOT / "experiments").glob("*.yaml")):
        try:
            directed_spec(undisturbed_spec(load_spec(file)))
        except package.TetractlError:
            refused.append(file.stem)
        else:
            assert file.stem in PLAYABLE
    assert refused == ["magnetospirillum_hold", "microjet_hold", "tetrahymena_hold"]


@needs_chromium
def test_arrow_keys_steer_all_robots_and_space_stops_them(game):
    game.key("ArrowUp")
    advance(game, 1.0)
    headings = game.run("game.trial.poses.map((pose) => pose[2])")
    assert all(0.3 < heading < np.pi / 2 for heading in headings)
    assert headings[0] > headings[1]  # green turns faster
    game.key(" ")
    advance(game, 0.4)
    assert game.run("game.phase") == "ended"
    assert "Your error" in text(game, "message")
    assert "you, best of 1" in text(game, "results")


@needs_chromium
def test_a_direction_exactly_behind_the_robots_is_explained(game):
    game.run("game.world.robots.forEach((robot) => { robot.start[2] = 0; }); game.restart()")
    game.key("ArrowLeft")
    assert "exactly behind the robots" in text(game, "message")
    advance(game, 0.5)
    assert game.run("game.trial.poses[0][1]") == pytest.approx(300, abs=1e-6)


@needs_chromium
def test_a_drag_on_the_arena_sets_the_direction(game):
    x, y = game.run(
        "(() => { const box = document.getElementById('scene').getBoundingClientRect();"
        " return [box.left + box.width / 2, box.top + box.height / 2]; })()"
    )
    for kind, dx, dy in (
        ("mousePressed", 0, 0),
        ("mouseMoved", 30, -30),
        ("mouseReleased", 30, -30),
    ):
        button = {"button": "left", "buttons": 0 if kind == "mouseReleased" else 1, "clickCount": 1}
        game.call("Input.dispatchMouseEvent", type=kind, x=x + dx, y=y + dy, **button)
    assert game.run("game.wish") == pytest.approx(np.pi / 4)
    assert game.run("game.phase") == "driving"


@needs_chromium
def test_in_a_pause_nothing_moves_and_a_target_can_be_dragged(game):
    game.key("ArrowRight")
    advance(game, 0.5)
    game.key("p")
    poses = game.run("game.trial.poses")
    advance(game, 0.5)
    assert game.run("game.trial.poses") == poses
    x, y = game.run(
        "(() => { const box = document.getElementById('scene').getBoundingClientRect();"
        " const [px, py] = game.scene.place(...game.world.robots[1].target);"
        " return [box.left + px, box.top + py]; })()"
    )
    drag(game, (x, y), (x - 40, y))
    target = game.run("game.world.robots[1].target")
    assert target[0] < 690 and target[1] == pytest.approx(500, abs=1)
    game.key("Enter")
    assert "Stop the robots first" in text(game, "message")
    game.key(" ")
    game.key("Enter")
    assert "original robots, targets and obstacles" in text(game, "message")


@needs_chromium
def test_a_run_through_an_obstacle_or_over_the_edge_is_lost(game):
    game.run("game.world.shapes[0].corners[0][0] = game.world.robots[1].start[0] + 30")
    game.run("game.restart()")
    game.key("ArrowUp")
    advance(game, 4.0)
    assert game.run("game.phase") == "ended"
    assert "Lost: red drove into an obstacle" in text(game, "message")
    game.run("game.restore()")
    assert "Lost" not in text(game, "message")
    game.key("ArrowDown")
    advance(game, 5.0)
    assert "Lost: green drove over the edge" in text(game, "message")
    assert "lost: green drove over the edge" in text(game, "results")


@needs_chromium
def test_equal_robots_cannot_be_parted(game):
    """What the lesson shows: the same signal never changes the gap between equal robots."""
    gap = "(() => { const [g, r] = game.trial.poses; return [r[0] - g[0], r[1] - g[1]]; })()"
    game.run("document.getElementById('equal').click()")
    for key in ("ArrowUp", "ArrowRight", "ArrowDown", "ArrowLeft"):
        game.key(key)
        advance(game, 0.6)
        assert game.run(gap) == pytest.approx([0, 200], abs=1e-9)
    game.key(" ")
    advance(game, 0.4)
    assert "the gaps between them stay as they are" in text(game, "message")
    game.key("Enter")  # the original robots, for which the controller's trial was computed
    assert text(game, "robots").count("6") == 1
    game.run("game.restore()")
    for key in ("ArrowUp", "ArrowRight"):
        game.key(key)
        advance(game, 0.6)
    assert abs(game.run(gap)[0]) > 10


@needs_chromium
def test_the_controllers_trial_is_played_after_yours_and_both_errors_are_named(game):
    game.key("ArrowRight")
    advance(game, 1.0)
    game.key(" ")
    advance(game, 0.4)
    game.key("Enter")
    assert game.run("game.phase") == "watching"
    advance(game, 30.0)
    assert game.run("game.phase") == "watched"
    results = text(game, "results")
    assert "you, best of 1" in results and "the controller" in results
    assert "original robots" not in results


@needs_chromium
def test_a_try_with_changed_robots_is_not_compared_with_the_controllers(game):
    def try_once():
        game.key("ArrowRight")
        advance(game, 1.0)
        game.key(" ")
        advance(game, 0.4)

    try_once()
    original = text(game, "results")
    game.run("document.getElementById('equal').click()")
    try_once()
    results = text(game, "results")
    assert results.startswith(original)
    assert "you, best of 1" in results
    assert "you, last" in results and "with changed robots" in results


@needs_chromium
def test_an_obstacle_that_was_dragged_is_shown_where_it_is(game):
    """The picture of the ground is drawn again, also for another colour scheme."""
    still = "game.scene.still.toDataURL()"
    before = game.run(still)
    game.run("(() => { shift(game.world.obstacles[0], 100, -50); game.show(); })()")
    moved = game.run(still)
    assert moved != before
    game.run("document.getElementById('theme').click()")
    assert game.run(still) != moved


@needs_chromium
@pytest.mark.parametrize("width", [360, 800, 1600])
def test_the_page_is_as_wide_as_the_screen_and_no_wider(browser, tmp_path, width):
    show(browser, tmp_path, page_of(parse_spec(SPEC, "spec")), width, 740)
    assert browser.run("document.body.scrollWidth <= document.documentElement.clientWidth")
    assert browser.run("document.getElementById('scene').getBoundingClientRect().bottom < 740")


def test_the_page_needs_nothing_beside_it():
    page = page_of(parse_spec(SPEC, "spec"))
    assert not re.search(r"(src|href)=\"(?!data:|#)", page)
    assert "https://" not in page
    assert len(page.encode()) < 300_000


def test_the_page_has_the_specs_robots_without_its_disturbances():
    world = world_of(page_of(parse_spec(SPEC, "spec")))
    assert [robot["a"] for robot in world["robots"]] == [6, 2]
    assert world["robots"][0]["start"] == [300, 300, 0.3]
    assert world["motion"] == "exact"
    assert world["period"] == 0.2
    assert world["arena"] == [0, 0, 1000, 800]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--html", "play.html", "--speed", "2"], "--html writes a page"),
        (["--html", "nowhere/play.html"], "the folder nowhere does not exist"),
        (["--html", "play.html", "--set", "hold={radius: 100}"], "hold"),
    ],
)
def test_wrong_use_is_one_line(tmp_path, words, message):
    (tmp_path / "spec.yaml").write_text(SPEC)
    done = tetractl(tmp_path, "play", "spec.yaml", *words)
    assert done.returncode == 2
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "play.html").exists()


def test_the_command_writes_the_page_and_names_it(tmp_path):
    (tmp_path / "spec.yaml").write_text(SPEC)
    done = tetractl(tmp_path, "play", "spec.yaml", "--html", "play.html").ok()
    assert done.stdout == ""
    assert "play.html" in done.stderr
    assert '<canvas id="scene"' in (tmp_path / "play.html").read_text()


def test_the_page_shows_itself_in_a_notebook(tmp_path):
    file = tmp_path / "play.html"
    page = package.play_page(directed_spec(undisturbed_spec(parse_spec(SPEC, "spec"))), file=file)
    assert file.read_text() == page.page
    assert page._repr_html_().startswith('<iframe sandbox="allow-scripts" srcdoc="')
