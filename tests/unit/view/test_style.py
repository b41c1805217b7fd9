"""Tests of what all figures have in common: headlines, looks of batches, and files."""

from itertools import pairwise

import pytest

from tetractl.core.errors import UsageError
from tetractl.view.style import (
    ALARM,
    GREY,
    HEADLINE_GAP_IN,
    HEADLINE_IN,
    HEADLINE_LETTERS_PER_IN,
    SLATES,
    batch_look,
    figure,
    file_format,
    headline,
    legend,
    picture,
    save,
    sign,
    styled,
)

pytestmark = pytest.mark.slow


def drawn(width_in=4.0, height_in=2.0):
    with styled():
        drawing = figure(width_in, height_in)
        drawing.subplots().plot([0, 1], [0, 1])
    return drawing


def axes_height_in(drawing):
    drawing.get_layout_engine().execute(drawing)
    (axes,) = drawing.axes
    return axes.get_position().height * drawing.get_figheight()


@pytest.mark.parametrize(
    ("alarm", "lines"),
    [("", 1), ("damaged", 2), ("damaged " * int(4 * HEADLINE_LETTERS_PER_IN / 8 + 1), 3)],
)
def test_a_headline_makes_a_figure_taller_by_its_lines_and_leaves_the_axes_as_they_are(
    alarm, lines
):
    drawing = drawn()
    before_in = axes_height_in(drawing)
    headline(drawing, "three-m3pi", alarm)
    assert drawing.get_figheight() == pytest.approx(2.0 + HEADLINE_IN * lines + HEADLINE_GAP_IN)
    assert axes_height_in(drawing) == pytest.approx(before_in, rel=0.02)
    shown = [(text.get_color(), text.get_position()[1]) for text in drawing.texts]
    assert [color for color, _ in shown] == [GREY, *[ALARM] * (lines - 1)]
    tops = [top * drawing.get_figheight() for _, top in shown]
    assert drawing.get_figheight() - tops[0] == pytest.approx(HEADLINE_GAP_IN)
    for upper, lower in pairwise(tops):
        assert upper - lower == pytest.approx(HEADLINE_IN)


@pytest.mark.parametrize(
    ("place", "moves"), [("outside upper center", True), ("lower center", False)]
)
def test_a_legend_above_the_axes_comes_below_the_headline_and_another_stays(place, moves):
    drawing = drawn()
    with styled():
        shown = drawing.legend(handles=[sign("a", marker="o")], loc=place)
    headline(drawing, "a headline")
    drawing.draw_without_rendering()
    box = shown.get_window_extent()
    lowest_text = min(text.get_window_extent().y0 for text in drawing.texts)
    assert box.y1 <= lowest_text
    assert (box.y0 > drawing.bbox.height / 2) == moves


def test_every_batch_has_a_look_of_its_own_first_by_colour_and_then_by_line():
    shades = len(SLATES)
    looks = [tuple(batch_look(number).values()) for number in range(3 * shades)]
    assert len(set(looks)) == len(looks)
    assert [color for color, _ in looks[:shades]] == list(SLATES)
    assert {line for _, line in looks[:shades]} == {"-"}
    assert {line for _, line in looks[shades : 2 * shades]} == {"--"}
    assert batch_look(3 * shades) == batch_look(0)


@pytest.mark.parametrize("name", ["a.png", "a.SVG", "a.b.pdf"])
def test_the_format_of_a_file_is_its_ending(tmp_path, name):
    assert file_format(tmp_path / name) == name.rpartition(".")[2].lower()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("a.jpg", "cannot write '.jpg' pictures"),
        ("png", "must state the format"),
        ("none/a.png", "the folder .*none does not exist"),
        ("folder.png", "this is a folder, but a file is needed"),
    ],
)
def test_a_file_that_cannot_be_written_is_refused(tmp_path, name, message):
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(UsageError, match=message):
        file_format(tmp_path / name)
    with pytest.raises(UsageError, match=message):
        save(drawn(), tmp_path / name)


def test_other_formats_may_be_asked_for(tmp_path):
    assert file_format(tmp_path / "a.mp4", ("mp4", "gif"), "video") == "mp4"
    with pytest.raises(UsageError, match=r"cannot write '\.png' videos"):
        file_format(tmp_path / "a.png", ("mp4", "gif"), "video")


def test_the_same_figure_gives_the_same_bytes():
    assert picture(drawn(), "svg") == picture(drawn(), "svg")


def test_a_legend_is_below_the_panels():
    drawing = drawn()
    with styled():
        legend(drawing, [sign("a", marker="o"), sign("b", marker="s")])
    drawing.draw_without_rendering()
    (axes,) = drawing.axes
    box = drawing.legends[0].get_window_extent()
    lowest = min(label.get_window_extent().y0 for label in axes.get_xticklabels())
    assert box.y1 <= lowest
    assert [text.get_text() for text in drawing.legends[0].get_texts()] == ["a", "b"]


def test_a_sign_of_a_legend_is_a_grey_marker_unless_it_has_another_look():
    plain, other = sign("a"), sign("b", color="red", ls="-")
    assert (plain.get_color(), plain.get_linestyle()) == (GREY, "None")
    assert (other.get_color(), other.get_linestyle(), other.get_label()) == ("red", "-", "b")
