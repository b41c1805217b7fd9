"""Tests of steering robots with keys, the mouse and a file of keys."""

import math
import threading

import pytest

from tetractl.core.errors import UsageError
from tetractl.spec.load import parse_contents
from tetractl.view.terminal.hand_keys import (
    MOUSE_OFF_SEQUENCE,
    MOUSE_ON_SEQUENCE,
    HandKeys,
    SteeringWish,
    describe_task,
    read_key_script,
)

NORTH = math.pi / 2


def wanted(*keys):
    """What is wanted after these keys."""
    wish = SteeringWish()
    for key in keys:
        wish = wish.after_key(key)
    return wish


@pytest.mark.parametrize(
    ("keys", "degrees"),
    [
        (["right"], 0),
        (["up"], 90),
        (["left"], 180),
        (["down"], -90),
        (["up", "x", "home", "down"], -90),
        (["<0;20;10M", "<32;30;10M"], 0),
        (["<0;20;10M", "<32;20;5M"], 90),
        (["<0;20;10M", "<32;22;11M"], -45),  # a cell is twice as high as wide
        (["<0;20;10M", "<32;30;10M", "<32;10;10M", "<0;10;10m"], 180),
        (["<0;20;10M", "<0;20;10m", "up", "<0;1;1M"], 90),
    ],
)
def test_arrows_and_drags_are_directions(keys, degrees):
    assert math.degrees(wanted(*keys).direction_or_stop) == pytest.approx(degrees)


@pytest.mark.parametrize("key", ["space", "q"])
def test_space_stops(key):
    assert wanted("up", key, "down").direction_or_stop is None


def test_the_first_key_is_waited_for():
    asked = threading.Event()

    def still_open():
        asked.set()
        return False

    answers = []
    with HandKeys(still_open) as steering:
        asking = threading.Thread(target=lambda: answers.append(steering.ask(0.0)))
        asking.start()
        assert asked.wait(60)
        assert not answers
        steering.press("up")
        asking.join(60)
        assert answers == [NORTH]
        assert steering.ask(0.2) == NORTH


def test_in_a_pause_each_direction_that_is_tried_is_shown_until_it_ends():
    steering = HandKeys(lambda: False, can_pause=True)
    steering.press("p")
    assert not steering.pauses  # nothing drives yet
    steering.press("up")
    steering.press("P")
    shown = []

    def show(direction):
        shown.append(direction)
        steering.press("right" if len(shown) == 1 else "p")

    steering.await_end_of_pause(show)
    assert shown == [NORTH, 0.0]
    assert steering.ask(0.2) == 0.0


def test_the_task_names_who_turns_fastest_and_slowest():
    robots = [
        {"name": name, "start": [0.2, 0.2], "target": [0.5, 0.5], "a": a, "speed": 0.1}
        for name, a in (("kim", 2), ("lea", 5), ("max", 3))
    ]
    arena = {"left": 0, "bottom": 0, "width": 1, "height": 1}
    contents = {
        "name": "x",
        "arena": arena,
        "units": {"length": "m"},
        "controller": {"type": "mpc"},
    }
    two = parse_contents(contents | {"robots": robots}, "x").experiment.setup
    assert "(lea fastest, kim slowest)" in describe_task(two, disturbed=False)
    assert "obstacle" not in describe_task(two, disturbed=False)
    assert "Dots: where that leads" in describe_task(two, disturbed=False)
    assert "Dots: about where that leads" in describe_task(two, disturbed=True)
    obstacle = {"type": "circle", "center": [0.3, 0.3], "radius": 0.01}
    with_one = parse_contents(contents | {"robots": robots, "obstacles": [obstacle]}, "x")
    assert "colour, round the yellow obstacle: total error 0. SPACE" in describe_task(
        with_one.experiment.setup, disturbed=False
    )
    one = parse_contents(contents | {"robots": robots[:1]}, "x").experiment.setup
    assert "fastest" not in describe_task(one, disturbed=False)


def script(folder, text):
    """A file of keys, read."""
    file = folder / "keys.txt"
    file.write_text(text)
    return read_key_script(file)


RIGHT = {
    "plain": "0 right\n1.5 up\n3 space\n",
    "comments and gaps": "# a lesson\n\n0 right  # go\n  1.5\tup\n\n3.0 space",
    "times from the first key": "10 right\n11.5 up\n13 space\n",
    "two keys at a time": "0 left\n0 right\n1.5 up\n3 q\n",
    "a byte order mark": "\ufeff0 right\n1.5 up\n3 space\n",
    "other forms of numbers": "0e0 right\n15e-1 up\n+3. space\n",
}


@pytest.mark.parametrize("text", RIGHT.values(), ids=RIGHT)
def test_a_script_presses_its_keys_in_time(text, tmp_path):
    keys = script(tmp_path, text)
    answers = [keys.ask(time_s) for time_s in (0.0, 1.45, 1.5, 2.95, 3.0, 9.0)]
    assert answers == [0.0, 0.0, NORTH, NORTH, None, None]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("0 right\n1 north\n", ":2: there is no key 'north'"),
        ("0 right\nup\n", ":2: the line must have the form SECONDS KEY"),
        ("0 right up\n", ":1: the line must have the form SECONDS KEY"),
        ("0 right\nsoon up\n", ":2: 'soon' is not a time in seconds"),
        ("-1 right\n", ":1: '-1' is not a time in seconds"),
        ("0 right\nnan up\n", ":2: 'nan' is not a time in seconds"),
        ("2 right\n1 up\n", ":2: the time 1 s is before the previous line's 2 s"),
        ("# nothing\n", ": the script steers no robot"),
        ("0 space\n", ": the script steers no robot"),
    ],
)
def test_a_wrong_script_is_one_line(text, problem, tmp_path):
    with pytest.raises(UsageError) as caught:
        script(tmp_path, text)
    assert caught.value.message == f"{tmp_path / 'keys.txt'}{problem}"


@pytest.mark.parametrize(
    ("key", "answer"), [("enter", "enter"), ("R", "r"), ("r", "r"), ("q", "q")]
)
def test_a_key_that_answers_the_words_before_they_are_waited_for_counts(key, answer):
    """Regression: it was forgotten, as when the machine is slow."""
    steering = HandKeys(lambda: False)
    steering.press("q")
    steering.forget_answer()
    steering.press(key)
    assert steering.await_answer() == answer


@pytest.mark.parametrize(
    "keys", [[], ["x"], ["<0;20;10M"], ["<0;20;10M", "<32;20;10M"], ["<32;9;9M"], ["<2;9;9M"]]
)
def test_other_keys_and_the_mouse_without_a_drag_ask_for_nothing(keys):
    assert wanted(*keys).direction is None


def test_the_robots_of_a_lab_do_not_wait():
    steering = HandKeys(lambda: False)
    steering.press("up")
    steering.press("p")
    assert not steering.pauses


def test_a_trial_that_ends_before_the_first_key_is_not_waited_for():
    assert HandKeys(lambda: True).ask(0.0) is None


def test_a_hand_that_still_steers_answers_nothing():
    steering = HandKeys(lambda: True)
    for key in ("up", "space", "x", "[<32;24;8M"):
        steering.press(key)
    assert steering.await_answer() == "q"  # of a trial that has ended for another reason


def test_the_terminal_tells_of_its_mouse_inside_the_block_alone(capsys):
    steering = HandKeys(lambda: False)
    with pytest.raises(RuntimeError), steering:
        assert capsys.readouterr().err == MOUSE_ON_SEQUENCE
        raise RuntimeError
    assert capsys.readouterr().err == MOUSE_OFF_SEQUENCE
    assert steering.ask(0.0) is None  # a thread that still asks ends
