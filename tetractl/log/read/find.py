"""Find the logs of trials in the files, folders and patterns that a user names."""

import re
from collections.abc import Iterable
from glob import has_magic
from pathlib import Path

from tetractl.core.errors import UsageError

SUFFIX = ".mcap"
"""End of the name of a complete log."""
LOG_PART = ".mcap.part"
"""End of the name of a log whose trial is still running, or has not ended properly."""
RECOVERED_SUFFIX = ".recovered.mcap"
"""End of the name of a log that was recovered from a damaged log."""
_NO_LOGS = re.compile(r"\.(csv|gif|html|jsonl?|mp4|parquet|pdf|png|svg|webp|ya?ml)$", re.IGNORECASE)
_LOG = re.compile(r"\.mcap(\.part)?$")
_SET_ASIDE = re.compile(r"\.attempt-\d+\.(recovered\.)?mcap(\.part)?$")


def attempt_name(log: str, number: int) -> str:
    """Return the new name of a log that `--resume` sets aside, such as trial-003.attempt-1.mcap.

    Args:
        log: Present name of the log.
        number: Number of the attempt, from 1.
    """
    stem, suffix, remainder = log.partition(RECOVERED_SUFFIX if RECOVERED_SUFFIX in log else SUFFIX)
    return f"{stem}.attempt-{number}{suffix}{remainder}"


def is_set_aside(name: str) -> bool:
    """Check whether a file's name shows that `--resume` has set this log aside."""
    return _SET_ASIDE.search(name) is not None


def find_logs(paths: Iterable[Path | str], attempts: bool = False) -> list[Path]:
    """Find the logs in files, folders and patterns. Each log is listed once, in the given order.

    A path is a log, a folder or a pattern with `*`, `?`, `[...]` or `**`. A folder gives the logs
    in it and in its sub-folders, sorted by name with numbers in numerical order. A .part file
    counts as a log unless the finished log also exists, because a crashed trial belongs to its
    batch. A recovered log is left out if its source is among the paths.

    Args:
        paths: The paths. Files whose endings show that they are not logs are left out.
        attempts: Whether folders and patterns also give the logs that `--resume` set aside.

    Raises:
        UsageError: If a path does not exist, or a folder or a pattern contains no logs.
    """
    logs: dict[Path, Path] = {}  # by the real path
    for path in without_other_files(paths):
        for log in _expand(path, attempts):
            logs.setdefault(log.resolve(), log)
    return [
        log for real_path, log in logs.items() if not _possible_sources(real_path) & logs.keys()
    ]


def without_other_files(paths: Iterable[Path | str]) -> list[Path]:
    """Leave out the files whose endings show that they are not logs, such as .csv and .png.

    A pattern such as `logs/slip/*` also matches such files: besides the folders of its arms, a
    study contains tables and figures.

    Raises:
        UsageError: If no path is left.
    """
    listed = [Path(path) for path in paths]
    remaining = [path for path in listed if not (_NO_LOGS.search(path.name) and path.is_file())]
    if listed and not remaining:
        first_path = listed[0]
        raise UsageError(
            f"{first_path}: this is not a log (*{SUFFIX})", _hint_without_logs(first_path)
        )
    return remaining


def _hint_without_logs(path: Path) -> str | None:
    """Suggest what the user may have meant by a path to a file that is not a log.

    The result is None if there is no suggestion.
    """
    if path.suffix.lower() in (".yaml", ".yml"):
        return f"run it with: tetractl run {path}"
    logs = sorted(path.parent.glob(f"*{SUFFIX}"), key=_natural_sort_key)
    if logs:
        return f"name the log of a trial, such as {logs[0]}"
    return f"name the folder instead: {path.parent}" if path.parent.name else None


def find_log(path: Path | str) -> Path:
    """Find the only log in a path.

    Raises:
        UsageError: If there is no log, or more than one log.
    """
    logs = find_logs([path])
    if len(logs) > 1:
        raise UsageError(f"{path}: {len(logs)} logs", f"name one of its logs, such as {logs[0]}")
    return logs[0]


def _possible_sources(log: Path) -> set[Path]:
    """Return the paths of the logs from which a recovered log may have been copied.

    The result is empty for a log that was not recovered.
    """
    if not log.name.endswith(RECOVERED_SUFFIX):
        return set()
    stem = log.name.removesuffix(RECOVERED_SUFFIX)
    return {log.with_name(stem + suffix) for suffix in (SUFFIX, LOG_PART)}


def _expand(path: Path, attempts: bool) -> list[Path]:
    if path.is_dir():
        logs = _logs_in_folder(path, attempts)
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
        for match in _matching_paths(path)
        for log in (_logs_in_folder(match, attempts) or _filter_logs([match], attempts))
    ]
    if not logs:
        raise UsageError(f"{path}: no log matches this pattern")
    return logs


def _matching_paths(pattern: Path) -> list[Path]:
    root = Path(pattern.anchor)  # Path.glob refuses absolute patterns
    try:
        matches = root.glob(str(pattern.relative_to(root)))
        return sorted(matches, key=_natural_sort_key)
    except ValueError as error:
        raise UsageError(f"{pattern}: {error}") from None


def _logs_in_folder(folder: Path, attempts: bool) -> list[Path]:
    logs = set(_filter_logs(folder.rglob("*"), attempts))
    return sorted((log for log in logs if log.with_suffix("") not in logs), key=_natural_sort_key)


def _filter_logs(paths: Iterable[Path], attempts: bool) -> list[Path]:
    return [
        path
        for path in paths
        if (attempts if is_set_aside(path.name) else _LOG.search(path.name)) and path.is_file()
    ]


def _natural_sort_key(path: Path) -> list[list[tuple[int, int, str]]]:
    """Return a sorting key that puts trial-2 before trial-10, and x=0/t before x=0.1/t.

    Numbers in the parts of the path count by their value.
    """
    key: list[list[tuple[int, int, str]]] = []
    for part in path.parts:
        pieces = re.split(r"(\d+)", part)
        key.append(
            [(int(piece), 1, "") if piece.isdecimal() else (0, 0, piece) for piece in pieces]
        )
    return key
