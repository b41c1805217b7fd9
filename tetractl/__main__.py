"""Makes `python -m tetractl` the same as the command `tetractl`."""

import sys

if not sys.flags.safe_path:
    del sys.path[0]  # the present folder, whose json.py is not ours

from tetractl.cli import main

main()
