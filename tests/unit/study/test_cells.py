from tetractl.study.arm import arm_name
from tetractl.study.cells import as_cell, shown

ROBOTS = ({"name": "green", "a": 6}, {"name": "red", "a": 3})


def test_a_list_of_mappings_is_shown_by_its_length_and_kept_whole_in_a_table():
    assert shown(ROBOTS) == "2"
    assert arm_name("ours", {"robots": ROBOTS}) == "ours-robots=2"
    assert '"green"' in as_cell(ROBOTS)


def test_other_values_are_shown_as_they_are():
    assert [shown(v) for v in (0.1234567, 3, "arc", True, [1, 2], [])] == [
        "0.123457",
        "3",
        "arc",
        "true",
        "[1, 2]",
        "[]",
    ]
