"""Plays a recorded trial on the terminal's alternate screen, controlled by keys."""

from rich.console import Console
from rich.live import Live

from tetractl.core.clock import seconds
from tetractl.core.colors import robot_colors
from tetractl.replay.player import Playback, Player
from tetractl.replay.recording import Recording
from tetractl.view.terminal.dashboard import Dashboard, Footer
from tetractl.view.terminal.glyphs import Glyphs, glyphs_for
from tetractl.view.terminal.keys import Keyboard

FRAME_S = 1 / 15
SPACE = {Playback.PLAYING: "pause", Playback.PAUSED: "play ", Playback.ENDED: "again"}


def play(console: Console, recording: Recording, player: Player) -> None:
    """Play until the key q is pressed."""
    setup = recording.log.start.setup
    colors = robot_colors(setup.names, setup.colors)
    drawn: object = None
    with (
        Live(console=console, screen=True, auto_refresh=False, redirect_stderr=False) as live,
        Keyboard(leave=live.stop, back=lambda: live.start(refresh=True)) as keyboard,
    ):
        while player.state is not Playback.QUIT:
            player.update()
            scene = (player.now, player.rate, player.state, console.size)
            if scene != drawn:
                drawn = scene
                live.update(dashboard(recording, player, colors, glyphs_for(console)), refresh=True)
            for key in keyboard.read(FRAME_S):
                player.press(key)


def dashboard(recording: Recording, player: Player, colors: list[str], glyphs: Glyphs) -> Dashboard:
    """Return the view at the player's time."""
    log = recording.log
    sign = glyphs.play if player.state is Playback.PLAYING else glyphs.pause
    end_s = seconds(recording.end_ns)
    wide = len(f"{end_s:.1f}")
    footer = Footer(
        left=f"{sign} {player.rate:g}{glyphs.times}",
        fraction=player.now / recording.end_ns if recording.end_ns else 1.0,
        right=f"{seconds(player.now):{wide}.1f} / {end_s:.1f} s",
        hints=(
            f"space {SPACE.get(player.state, '')}",
            f"{glyphs.left_right} {glyphs.plus_minus}1 s",
            ". step",
            "q quit",
            "+/- rate",
        ),
    )
    heading = f"{log.start.setup.name}, trial {log.start.trial}"
    notes = ("damaged log", *log.damage.lost) if log.damage else ()
    return Dashboard(recording.at(player.now), colors, heading, footer, notes)
