"""`tetractl lab bundle`: packs a report on a lab into one archive, without names and addresses."""

from pathlib import Path
from typing import Annotated

from tetractl.cli.options import argument, option, out_option
from tetractl.core.errors import Exit, printable


def bundle(
    files: Annotated[
        list[Path],
        argument(
            "FILE...",
            "Files to put into the bundle: logs, folders of logs, "
            "network captures (pcap) and text files.",
        ),
    ],
    out: Annotated[Path, out_option("FILE", "Zip file to write.")],
    remove: Annotated[
        list[str] | None,
        option(
            "NAME",
            "Name to replace by an alias everywhere in the bundle. Can be repeated.",
            "--remove",
        ),
    ] = None,
) -> int:
    """Pack logs, captures and texts for a report, without names and addresses.

    The command replaces IP addresses, network cards, radios, e-mail addresses, host names of URLs,
    home folders and this computer's name by aliases, which are the same in all files. Other names,
    such as those of people in the comments of a spec, stay unless you give them with --remove. Logs
    remain valid, with their spec and environment. A capture keeps the content of its UDP and TCP
    packets. Images stay unchanged.

    Example: tetractl lab bundle logs/first lab.txt calibration.yaml natnet.pcap -o report.zip
    """
    from tetractl.log.bundle.bundle import contents_text, write_bundle

    written = write_bundle(files, out, remove or [])
    print(printable_lines(contents_text(written)), end="")
    print(f"wrote {printable(str(out))}: look at its contents before you send it")
    return Exit.DONE


def printable_lines(text: str) -> str:
    """Return a text of several lines that is safe to print on a terminal."""
    return "".join(printable(line) + "\n" for line in text.splitlines())
