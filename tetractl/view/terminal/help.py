"""The keys of the player, on a screen of their own."""

from rich.console import Console, ConsoleOptions, RenderResult
from rich.segment import Segment
from rich.text import Text

from tetractl.view.terminal.glyphs import Glyphs

TITLE = "Keys of the player"


def keys(glyphs: Glyphs) -> tuple[tuple[str, str], ...]:
    """Return each key, or group of keys, and what it does."""
    return (
        ("space", "pause, play on; at the end: again from the start"),
        (glyphs.left_right, "1 s back or on"),
        (", .", "previous or next control step, and pause"),
        ("E e", "previous or next event, and pause"),
        ("Home End", "start or end"),
        ("+ -", "twice or half the rate"),
        ("p n", "previous or next trial, where several logs are given"),
        ("?", "show or hide this"),
        ("q", "quit"),
    )


class Help:
    """The list of keys as a rich renderable that fills the space available."""

    def __init__(self, glyphs: Glyphs) -> None:
        self._glyphs = glyphs

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width, height = options.max_width, options.height or console.height
        rows = keys(self._glyphs)
        wide = max(len(key) for key, _ in rows)
        lines = [Text(TITLE, "bold"), Text()] if height > len(rows) + 2 else []
        lines += [Text.assemble((f" {key:<{wide}}", "bold"), f"  {does}") for key, does in rows]
        for row in range(height):
            line = lines[row] if row < len(lines) else Text()
            line.no_wrap = True
            line.truncate(width)
            yield from Segment.adjust_line_length(list(line.render(console)), width)
            if row < height - 1:
                yield Segment.line()
