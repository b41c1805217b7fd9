"""Find the logs of trials in the files, folders and patterns that a user names."""

import re
from collections.abc import Iterable
from glob import has_magic
from pathlib import Path

from tetractl.core.errors import UsageError

SUFFIX = ".mcap"
LOG_PART = ".mcap.part"
"""End of the name of a log whose trial is still running, or has not ended properly."""
RECOVERED_SUFFIX = ".recovered.mcap"
_NO_LOGS = re.compile(r"\.(csv|gif|html|jsonl?|mp4|parquet|pdf|png|svg|webp|ya?ml)$", re.IGNORECASE)
_LOG = re.compile(r"\.mcap(\.part)?$")
_SET_ASIDE = re.compile(r"\.attempt-\d+\.(recovered\.)?mcap(\.part)?$")


def attempt_name(log: str, number: int) -> str:
    """Return the new name of a log that `--resume` sets aside, such as trial-003.attempt-1.mcap."""
    stem, suffix, rest = log.partition(RECOVERED_SUFFIX if RECOVERED_SUFFIX in log else SUFFIX)
    return f"{stem}.attempt-{number}{suffix}{rest}"


def is_set_aside(name: str) -> bool:
    """Check whether a file's name shows that `--resume` has set this log aside."""
    return _SET_ASIDE.search(name) is not None


def find_logs(paths: Iterable[Path | str], attempts: bool = False) -> list[Path]:
    """Return the logs in some paths, each once, in the order given.

    A path is a log, a folder or a pattern with `*`, `?`, `[...]` or `**`. A folder gives the logs
    in it and in its sub-folders, sorted by name with numbers in numerical order. A .part file
    counts as a log, since a crashed trial belongs to its batch, unless the finished log exists
    too. A recovered log is left out if its source is among the paths.

    Args:
        paths: The paths. Files whose endings show that they are not logs are left out.
        attempts: Whether folders and patterns also give the logs that `--resume` set aside.

    Raises:
        UsageError: If a path does not exist, or a folder or a pattern contains no logs.
    """
    logs: dict[Path, Path] = {}  # by the real path
    for path in without_others(paths):
        for log in _expand(path, attempts):
            logs.setdefault(log.resolve(), log)
    return [log for real, log in logs.items() if not _sources(real) & logs.keys()]


def without_others(paths: Iterable[Path | str]) -> list[Path]:
    """Leave out the files whose endings show that they are not logs, such as .csv and .png.

    A pattern such as `logs/slip/*` also matches such files: besides the folders of its arms, a
    study contains tables and figures.

    Raises:
        UsageError: If no path is left.
    """
    listed = [Path(path) for path in paths]
    remaining = [path for path in listed if not (_NO_LOGS.search(path.name) and path.is_file())]
    if listed and not remaining:
        first = listed[0]
        raise UsageError(f"{first}: this is not a log (*{SUFFIX})", _hint_without_logs(first))
    return remaining


def _hint_without_logs(path: Path) -> str | None:
    """Suggest what the user may have meant by a path to a file that is not a log.

    The result is None if there is no suggestion.
    """
    if path.suffix.lower() in (".yaml", ".yml"):
        return f"run it with: tetractl run {path}"
    logs = sorted(path.parent.glob(f"*{SUFFIX}"), key=_natural)
    if logs:
        return f"name the log of a trial, such as {logs[0]}"
    return f"name the folder instead: {path.parent}" if path.parent.name else None


def find_log(path: Path | str) -> Path:
    """Return the only log in a path.

    Raises:
        UsageError: If there is no log, or more than one.
    """
    logs = find_logs([path])
    if len(logs) > 1:
        raise UsageError(f"{path}: {len(logs)} logs", f"name one of its logs, such as {logs[0]}")
    return logs[0]


def _sources(log: Path) -> set[Path]:
    """Return the paths of the logs from which a recovered log may come; empty for any other log."""
    if not log.name.endswith(RECOVERED_SUFFIX):
        return set()
    stem = log.name.removesuffix(RECOVERED_SUFFIX)
    return {log.with_name(stem + suffix) for suffix in (SUFFIX, LOG_PART)}


def _expand(path: Path, attempts: bool) -> list[Path]:
    if path.is_dir():
        logs = _in_folder(path, attempts)
        if not logs:
            hint = (
                "if these are tables, give the files of poses and of commands to "
                "`tetractl identify`"
            )
            has_tables = any(path.glob("*.csv"))
            raise UsageError(
                f"{path}: this folder contains no logs (*{SUFFIX})", hint if has_tables else None
            )
        return logs
    if path.is_file():
        return [path]
    if path.exists():  # reading a FIFO or a device may never end
        raise UsageError(f"{path}: this is not a regular file")
    if not has_magic(str(path)):
        raise UsageError(f"{path}: there is no such file or folder")
    logs = [
        log
        for match in _matches(path)
        for log in (_in_folder(match, attempts) or _logs([match], attempts))
    ]
    if not logs:
        raise UsageError(f"{path}: no log matches this pattern")
    return logs


def _matches(pattern: Path) -> list[Path]:
    root = Path(pattern.anchor)  # Path.glob refuses absolute patterns
    try:
        matches = root.glob(str(pattern.relative_to(root)))
        return sorted(matches, key=_natural)
    except ValueError as error:
        raise UsageError(f"{pattern}: {error}") from None


def _in_folder(folder: Path, attempts: bool) -> list[Path]:
    logs = set(_logs(folder.rglob("*"), attempts))
    return sorted((log for log in logs if log.with_suffix("") not in logs), key=_natural)


def _logs(paths: Iterable[Path], attempts: bool) -> list[Path]:
    return [
        path
        for path in paths
        if (attempts if is_set_aside(path.name) else _LOG.search(path.name)) and path.is_file()
    ]


def _natural(path: Path) -> list[list[tuple[int, int, str]]]:
    """Return a sorting key that puts trial-2 before trial-10, and x=0/t before x=0.1/t.

    Numbers in the parts of the path count by their value.
    """
    key: list[list[tuple[int, int, str]]] = []
    for part in path.parts:
        pieces = re.split(r"(\d+)", part)
        key.append([(int(p), 1, "") if p.isdecimal() else (0, 0, p) for p in pieces])
    return key
