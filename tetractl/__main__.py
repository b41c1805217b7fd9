"""`python -m tetractl`, the same as `tetractl`."""

from tetractl.cli import main

main()
