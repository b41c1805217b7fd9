from tetractl.core.colors import ALARM, GREY, PALETTE, SLATES


def test_no_colour_has_two_meanings():
    every = [*PALETTE, *SLATES, GREY, ALARM]
    assert len(set(every)) == len(every)
