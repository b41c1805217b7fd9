import pytest
from pydantic import ValidationError
from testkit.microscope.field_bench import section


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"type": "lamp"}, "'field'"),
        ({"strength_mt": 0}, "greater than 0"),
        (
            {"coils": {"x": {"gain_mt_a": 0}, "y": {"gain_mt_a": 1}}},
            "must not be 0, because a coil with gain 0 makes no field",
        ),
        ({"current_max_a": 0.01}, "is too small to cancel the ambient field coils.x.offset_mt"),
        ({"rate": 10, "watchdog": 0.25}, "must be 0.3 s or more at 10 Hz"),
        ({"slew_max_a_s": float("inf")}, "finite"),
        ({"wheels": 2}, "Extra inputs"),
    ],
)
def test_what_cannot_be_is_one_clear_line(changes, says):
    with pytest.raises(ValidationError) as got:
        section(**changes)
    (error,) = got.value.errors()
    assert says in error["msg"]
    assert "\n" not in error["msg"]
