"""What is said if no server answers, no frame comes, or a body is not in the stream."""

from collections import Counter
from types import SimpleNamespace

import pytest

from tetractl.lab.cameras.optitrack import diagnosis
from tetractl.lab.cameras.optitrack.stream import StreamCounts

SECTION = SimpleNamespace(
    server="10.0.0.1", command_port=1510, transport="multicast", group="239.1.1.1", data_port=1511
)
ELSEWHERE = SimpleNamespace(host="10.0.0.9", port=1999)
SAME_HOST = SimpleNamespace(host="10.0.0.1", port=1999)


def senders(sender=None, count=5):
    return SimpleNamespace(
        find_main_refused_sender=lambda sends_frames: None if sender is None else (sender, count),
        refused_frame=b"",
        refused=Counter({} if sender is None else {sender.host: count}),
        frames_port=1511,
    )


def stream(**fields):
    usual = {
        "counts": StreamCounts(),
        "info": SimpleNamespace(version=(3, 1)),
        "version": (3, 1),
        "last_unread_frame": b"",
        "model": None,
        "streamed_ids": (),
        "robots": (),
        "up_axis_answer": None,
    }
    return SimpleNamespace(**usual | fields)


def model(*names, complete=True):
    bodies = [(name, number) for number, name in enumerate(names, 1)]
    return SimpleNamespace(bodies=bodies, ids=lambda: dict(bodies), complete=complete)


def robots(*bodies):
    return tuple(SimpleNamespace(body=body) for body in bodies)


def test_a_server_at_another_address_is_named_if_one_answers():
    error = diagnosis.create_no_server_error(SECTION, senders(ELSEWHERE), 2.0)
    assert "10.0.0.1:1510" in error.message
    assert "10.0.0.9" in error.hint
    assert "1999" in error.hint
    assert "10.0.0.9" not in diagnosis.create_no_server_error(SECTION, senders(), 2.0).message


@pytest.mark.parametrize(
    ("sender", "says", "hint"),
    [
        (None, "no frames came within 2 s", "multicast"),
        (ELSEWHERE, "from another address: 5 frames", "lab.camera.server to 10.0.0.9"),
        (SAME_HOST, "from the port that it reports, 1511", "data port in Motive to 1999"),
    ],
)
def test_why_no_frame_is_used_follows_from_where_frames_come_from(sender, says, hint):
    error = diagnosis.create_no_frames_error(SECTION, senders(sender), stream(), 2.0)
    assert says in error.message
    assert hint in error.hint


@pytest.mark.parametrize(
    ("version", "reported", "hint"),
    [
        ((2, 9), (3, 1), "remove lab.camera.version"),
        ((3, 1), (3, 1), "in unicast"),
        ((99, 0), (99, 0), "lab.camera.transport to unicast"),
    ],
)
def test_frames_of_the_server_that_cannot_be_read_matter_more_than_those_of_others(
    version, reported, hint
):
    of_server = stream(
        counts=StreamCounts(unread_frames=3),
        version=version,
        info=SimpleNamespace(version=reported),
    )
    error = diagnosis.create_no_frames_error(SECTION, senders(ELSEWHERE), of_server, 2.0)
    assert "3 frames came" in error.message
    assert hint in error.hint


@pytest.mark.parametrize(
    ("answer", "says"), [(None, "does not report"), (0, "up axis is x"), (7, "of number 7")]
)
def test_an_axis_that_cannot_be_up_is_named(answer, says):
    assert says in diagnosis.create_up_axis_error(stream(up_axis_answer=answer)).message


@pytest.mark.parametrize(("unread", "says"), [(0, "did not answer a request"), (2, "cannot be")])
def test_bodies_whose_names_are_unknown_are_wanted_by_name(unread, says):
    asked = stream(
        counts=StreamCounts(unread_models=unread), robots=robots("green", 4), streamed_ids=(3, 4)
    )
    error = diagnosis.create_names_error(asked, 1.0)
    assert "'green'" in error.message
    assert says in error.message
    assert error.hint.endswith("3, 4")


@pytest.mark.parametrize(
    "count", [0, 1, diagnosis.BODIES_SHOWN_MAX, diagnosis.BODIES_SHOWN_MAX + 1, 40]
)
def test_at_most_some_bodies_are_listed_and_the_rest_counted(count):
    listed = diagnosis.list_bodies(stream(streamed_ids=tuple(range(count)))).split("; ")
    if count == 0:
        assert listed == ["none"]
    else:
        assert listed[0] == "id 0"
        assert len(listed) == min(count, diagnosis.BODIES_SHOWN_MAX + 1)
        assert (f"{count - diagnosis.BODIES_SHOWN_MAX} more" == listed[-1]) == (
            count > diagnosis.BODIES_SHOWN_MAX
        )


def test_a_body_is_listed_with_its_name_and_whether_it_is_streamed():
    line = diagnosis.list_bodies(stream(model=model("green", "blue"), streamed_ids=(2, 9)))
    assert line == "'green' (id 1), not streamed; 'blue' (id 2); id 9"


def missing_of(*wanted, streamed_ids, complete=True):
    """Of cameras that know green and blue (ids 1 and 2), which lines are said."""
    of_robots = robots(*wanted)
    known = model("green", "blue", complete=complete)
    ids = known.ids()
    missing = [body for body in wanted if ids.get(body, body) not in streamed_ids]
    made = stream(
        model=known,
        streamed_ids=streamed_ids,
        robots=of_robots,
        list_missing_bodies=lambda: missing,
    )
    return diagnosis.describe_missing_bodies(made, tuple(f"robot {body}" for body in wanted))


def test_only_a_robot_whose_body_is_not_streamed_is_named():
    assert missing_of("green", "blue", streamed_ids=(1, 2)) == []
    (line,) = missing_of("green", "blue", streamed_ids=(2,))
    assert "does not stream the rigid body 'green' for robot green" in line


def test_an_unknown_body_is_named_with_the_most_similar_one_that_is_free():
    (line,) = missing_of("gren", "blue", streamed_ids=(1, 2))
    assert "has no rigid body 'gren'" in line
    assert "green" in line.partition("they have")[0]
    (line,) = missing_of(7, streamed_ids=(1, 2))
    assert "has no rigid body with id 7 for robot 7; the nearest id is 2" in line
    (line,) = missing_of(7, streamed_ids=())
    assert "nearest" not in line


def test_a_list_of_bodies_that_is_cut_off_is_told():
    assert len(missing_of(7, streamed_ids=(1,), complete=False)) == 2
    assert missing_of("green", streamed_ids=(1,), complete=False) == []


def test_before_the_list_of_bodies_has_come_none_is_missing():
    assert diagnosis.describe_missing_bodies(stream(model=None), ()) == []


def test_dropped_datagrams_are_told_and_nothing_if_none_was_dropped():
    assert diagnosis.describe_dropped_datagrams(senders(), stream()) == []
    (line,) = diagnosis.describe_dropped_datagrams(senders(ELSEWHERE), stream())
    assert line.startswith("5 datagrams")
    assert "10.0.0.9" in line
    (line,) = diagnosis.describe_dropped_datagrams(
        senders(), stream(counts=StreamCounts(unrequested=4))
    )
    assert line.startswith("4 answers")
