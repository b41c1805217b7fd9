"""Tests of the page of `tetractl report`, used offline in a headless Chromium."""

import json
import re

import pytest
from testkit.chromium import chromium, needs_chromium
from testkit.cli import tetractl

from tetractl.log.read.reader import read_trial
from tetractl.report.page import PLAYER_PX, player

pytestmark = pytest.mark.slow

SPEC = """
name: quick
description: "<b>bold</b> & <script>alert(1)</script>"
arena: {left: 0, bottom: 0, width: 1000, height: 800}
robots:
  - {name: one, start: [100, 500], target: [300, 500], a: 6, speed: 200}
  - {name: two, start: [100, 200], target: [300, 250], a: 3, speed: 200}
obstacles: [{type: circle, center: [600, 600], radius: 50}]
controller: {type: pso-mpc, horizon_max: 8, steps_max: 30,
  optimizer: {particles: 20, iterations: 20}}
plant: {type: sim, dead_time: 0.1, heading_noise: 0.1}
trials: {count: 3, seed: 7}
reference: {source: somewhere, n: 20, mean: 300, std: 100}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with `logs` of three trials and their `report.html`."""
    place = tmp_path_factory.mktemp("report")
    (place / "quick.yaml").write_text(SPEC)
    assert tetractl(place, "run", "quick.yaml", "--out", "logs", "--quiet").returncode == 0
    done = tetractl(place, "report", "logs")
    assert (done.returncode, done.stdout) == (0, "report.html\n"), done.stderr
    return place


@pytest.fixture(scope="module")
def statistics(folder):
    return json.loads(tetractl(folder, "stats", "logs", "--format", "json").stdout)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with chromium(tmp_path_factory.mktemp("profile")) as started:
        yield started


@pytest.fixture
def page(folder, browser):
    show(browser, folder)
    yield browser
    assert browser.errors == []


def show(browser, folder, width=1280, height=800, page="report.html"):
    """Open the report and wait until its first trial is shown."""
    browser.open(folder / page, width, height)
    browser.run(
        "new Promise((done) => { const wait = () => window.player"
        " ? done() : setTimeout(wait, 5); wait(); })"
    )


def text(page, name):
    return page.run(f"document.getElementById('{name}').textContent")


@pytest.mark.long
def test_the_page_needs_nothing_beside_it(folder):
    html = (folder / "report.html").read_text()
    assert not re.search(r"(src|href)=\"(?!data:|#)", html)
    assert "https://" not in re.sub(r"<pre>.*?</pre>", "", html, flags=re.DOTALL)
    assert "alert(1)</script>" not in html
    assert len(html) < 1_500_000


@pytest.mark.system
def test_the_interval_of_the_mean_is_that_of_stats_digit_for_digit(folder):
    """Regression: 116.04 to 170.45 in the report, 116.0 to 170.4 in the terminal."""
    total = tetractl(folder, "stats", "logs").stdout.partition("\n total ")[2].partition("\n")[0]
    interval = re.search(r"[\d.]+ to [\d.]+", total)
    assert interval
    html = (folder / "report.html").read_text()
    row = html.partition("mean total error")[2].partition("</table>")[0]
    assert f">{interval[0]}<" in row and f">{total.split()[1]}<" in row


@pytest.mark.long
def test_the_same_logs_give_the_same_page(folder):
    assert tetractl(folder, "report", "logs", "-o", "again.html").returncode == 0
    assert (folder / "again.html").read_text() == (folder / "report.html").read_text()


@needs_chromium
def test_the_page_shows_the_numbers_of_stats(page, statistics):
    inside = json.loads(page.run("document.querySelector('script.statistics').textContent"))
    assert inside == statistics
    rows = page.run(
        "[...document.querySelectorAll('details table tbody tr')]"
        ".map((row) => Number(row.cells[2].textContent))"
    )
    errors = [trial["total_error"] for trial in statistics["trials"]]
    assert rows == pytest.approx(errors, abs=0.06)
    links = page.run(
        "[...document.querySelectorAll('svg.errors a')]"
        ".map((dot) => dot.getAttribute('xlink:href'))"
    )
    assert links == ["#trial-1", "#trial-2", "#trial-3"]
    mean = page.run("document.querySelector('.top tbody').rows[0].cells[2].textContent")
    assert float(mean) == pytest.approx(statistics["total_error"]["mean"], abs=0.06)
    for error in errors:
        page.key("End")
        assert float(text(page, "total")) == pytest.approx(error, rel=5e-3)
        assert text(page, "known") == "true, as in the tables"
        page.key("]")
        page.run("player.opened")


@needs_chromium
def test_it_opens_at_the_result_and_plays_from_the_start(page):
    assert page.run("player.time === player.trial.end")  # opens at the result
    assert text(page, "outcome").startswith("sequence completed: ")
    page.run(
        "document.getElementById('rate').value = '10';"
        "document.getElementById('rate').dispatchEvent(new Event('change'))"
    )
    page.key(" ")
    page.run(
        "new Promise((done) => { const wait = () => player.playing"
        " ? requestAnimationFrame(wait) : done(); wait(); })"
    )
    assert page.run("player.time === player.trial.end")
    assert page.run("player.frames") > 1


@needs_chromium
def test_it_scrubs_and_steps(page):
    page.run("player.opened")
    page.run(
        "{ const s = document.getElementById('scrub'); s.value = 0.45;"
        " s.dispatchEvent(new Event('input')); }"
    )
    assert text(page, "step") == "2"
    page.key(".")
    assert text(page, "step") == "3"
    page.key(",")
    assert text(page, "step") == "2"
    said = page.run("document.getElementById('scrub').getAttribute('aria-valuetext')")
    assert said.startswith("0.40 s, step 2, total error ")
    assert said.endswith(", measured")
    page.key("Home")
    assert text(page, "time").startswith("0.00 s of ")


@needs_chromium
@pytest.mark.parametrize("width", [560, 800, 1150])
def test_in_a_notebook_the_player_fits_into_its_frame(browser, folder, width):
    """Regression: half of it was below the frame's edge, the controls with it at 1150 px."""
    shown = player([read_trial(folder / "logs" / "trial-000.mcap")])
    (folder / "frame.html").write_text(shown.page)
    show(browser, folder, width, PLAYER_PX, page="frame.html")
    assert browser.run("document.documentElement.scrollHeight") <= PLAYER_PX
    bottoms = browser.run(
        "['scene', 'scrub', 'play', 'total'].map("
        "(name) => document.getElementById(name).getBoundingClientRect().bottom)"
    )
    assert max(bottoms) < PLAYER_PX


@pytest.mark.system
def test_the_folder_of_a_study_is_a_page_of_its_arms_called_after_it(tmp_path):
    (tmp_path / "quick.yaml").write_text(SPEC)
    (tmp_path / "study.yaml").write_text(
        "name: delays\nbase: quick.yaml\ntrials: {count: 2}\n"
        "sweep: {type: grid, fields: {plant.dead_time: [0, 0.1]}}\n"
    )
    tetractl(tmp_path, "study", "study.yaml", "-o", "delays", "--quiet").ok()
    tetractl(tmp_path, "report", "delays").ok()
    html = (tmp_path / "report.html").read_text()
    assert "<h1>delays</h1>" in html
    assert re.findall(r"<option value=\"\d\">(\d: [^<]*)", html) == [
        f"{2 * arm + trial + 1}: dead_time={value}, trial-00{trial}.mcap"
        for arm, value in enumerate(("0", "0.1"))
        for trial in range(2)
    ]
    head = html[html.index("<header>") : html.index("Comparison of")]
    assert re.findall(r'<th scope="row">([^<]*)', head) == ["dead_time=0", "dead_time=0.1"]
    assert "sum over the robots" in head
    assert html.index("verdict on the mean error") < html.index('<section id="player"')


@needs_chromium
def test_curves_follow_the_theme(page):
    """Regression: in the dark they kept the colour that they had on a light page."""
    painted = """
        (() => {
          const { canvas } = player.charts.cost, probe = document.createElement("canvas");
          const [context, ink] = [canvas.getContext("2d"), probe.getContext("2d")];
          ink.fillStyle = getComputedStyle(document.documentElement).getPropertyValue("--whole");
          ink.fillRect(0, 0, 1, 1);
          const wanted = ink.getImageData(0, 0, 1, 1).data.join();
          const { data } = context.getImageData(0, 0, canvas.width, canvas.height);
          const starts = [...Array(data.length / 4).keys()];
          return starts.some((i) => data.slice(4 * i, 4 * i + 4).join() === wanted);
        })()
    """
    toggle = "document.getElementById('theme').click()"
    for _ in range(2):
        assert page.run(painted)
        page.run(toggle)


@needs_chromium
def test_the_dots_of_a_figure_are_one_stop_of_the_tab_key(page):
    """Regression: there were as many stops as trials."""
    stops = """
        [...document.querySelectorAll("svg.errors")]
          .map((drawing) => drawing.querySelectorAll('a:not([tabindex="-1"])').length)
    """
    dots = page.run('document.querySelectorAll("svg.errors a").length')
    assert dots > len(page.run(stops))
    assert set(page.run(stops)) == {1}
    page.run(
        """
        (() => {
          const first = document.querySelector("svg.errors a");
          first.focus();
          first.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight", bubbles: true }));
        })()
        """
    )
    moved = "[...document.querySelectorAll('svg.errors a')].indexOf(document.activeElement)"
    assert page.run(moved) == 1
    assert set(page.run(stops)) == {1}
