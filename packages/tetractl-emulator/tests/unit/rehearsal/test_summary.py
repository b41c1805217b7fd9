"""Tests of the summary of many rehearsed days."""

from tetractl_emulator.rehearsal.summary import reasons, summary, table

ROWS = [
    {"met": [["pushed", 0.2]], "ended": "aborted", "seconds": 1.0, "violations": []},
    {"met": [["pushed", 0.4]], "ended": "aborted", "seconds": 2.0, "violations": []},
    {"met": [["pushed", None]], "ended": "complete", "seconds": 2.0, "violations": []},
    {
        "met": [["pushed", 9.0], ["nan", 8.0]],
        "ended": "refused",
        "seconds": 3.0,
        "violations": [["enters", 1.0, "green"]],
    },
]


def test_times_are_of_days_with_one_fault():
    lines = table(ROWS).splitlines()
    assert "| pushed | 4 | 3 | 2 | 0.300 | 0.398 | 0.400 |" in lines
    assert "| nan | 1 | 0 | 0 |  |  |  |" in lines
    assert len(lines) == 4


def test_shares_and_what_a_day_takes_are_said():
    assert summary(ROWS) == (
        "2 aborted (50%); 1 complete (25%); 1 refused (25%); 2.00 s of processor time a day"
    )
    assert summary([]) == "0.00 s of processor time a day"


def test_reasons_are_counted_whatever_their_numbers():
    texts = ("", "no frame for 0.51 s", "green is lost", "no frame for 2 s")
    rows = [{"reason": text} for text in texts]
    assert reasons(rows) == "2 days: no frame for … s\n1 day: green is lost"
