"""Read the text of a spec, and of the files that it refers to."""

from pathlib import Path

from tetractl.core.errors import SpecError, printable
from tetractl.spec.yaml.problems import InvalidSpecError, SpecProblem, suggest_files

MAX_BYTES = 1 << 20
"""Maximum size of a spec file [bytes]."""


def resolve_path(folder: Path | None, key: str, name: str) -> Path:
    """Resolve a file name in a spec to a path, relative to the folder of the spec.

    Args:
        folder: The folder of the spec. None if the spec comes from no file, as in a log.
        key: The key of the spec that names the file, for error messages.
        name: The name of the file.

    Raises:
        SpecError: If the name is relative, and there is no folder.
    """
    if folder is None and not Path(name).is_absolute():
        raise SpecError(
            f"{key}: {printable(name)}: this path is relative to the folder of the spec, but "
            "the spec was not read from a file",
            f"give its full path with --set {key}=/PATH, or leave the file out with --set "
            f"{key}=null",
            f'give its full path with "{key}=/PATH", or leave the file out with "{key}=null"',
        )
    return (folder or Path()) / name


SPEC_TEXT = "a spec is YAML text"
"""The description of the file that `read_text` expects, unless its caller gives another one."""


def read_text(path: Path, max_bytes: int = MAX_BYTES, expected: str = SPEC_TEXT) -> str:
    """Read a spec, a file that a spec names, or another file of text.

    Args:
        path: The file.
        max_bytes: Maximum size of the file [bytes].
        expected: Description of the expected file, for messages.

    Raises:
        InvalidSpecError: If the file is missing, is too large or cannot be read as UTF-8 text.
    """

    def refusal(message: str, line: int | None = None, column: int | None = None) -> Exception:
        problem = SpecProblem(printable(str(path)), message, line, column)
        return InvalidSpecError([problem])

    try:
        if path.exists() and not (path.is_file() or path.is_dir()):  # reading a FIFO may never end
            raise refusal("is not a regular file")
        with path.open("rb") as stream:
            contents = stream.read(max_bytes + 1)
    except FileNotFoundError:
        raise refusal(f"there is no such file{suggest_files(path)}") from None
    except IsADirectoryError:
        file = "YAML file" if expected == SPEC_TEXT else "file"
        raise refusal(f"is a folder; name a {file} in this folder") from None
    except OSError as error:
        raise refusal(f"cannot be read: {error.strerror or error}") from None
    except ValueError as error:  # a null character in the name
        raise refusal(f"cannot be read: {error}") from None
    if len(contents) > max_bytes:
        is_spec = expected == SPEC_TEXT and max_bytes == MAX_BYTES
        size_hint = ", but a spec is a few kilobytes of YAML" if is_spec else ""
        raise refusal(f"is larger than {max_bytes >> 20} MiB{size_hint}")
    if b"\0" in contents:
        raise refusal(f"is a binary file; {expected}")
    try:
        return contents.decode("utf-8")
    except UnicodeDecodeError as error:
        bytes_before = contents[: error.start]
        line = bytes_before.count(b"\n") + 1
        column = error.start - bytes_before.rfind(b"\n")
        raise refusal("is not UTF-8 text; save the file as UTF-8", line, column) from None
