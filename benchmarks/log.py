"""What logs promise, measured: `python benchmarks/log.py [PART]...`, all parts by default.

    kills       seconds lost over 100 kills -9 at random times of a trial in real time
    torn        10,000 truncations and 10,000 changed bytes: chunks recovered of those complete
    mutations   every number of every decision changed once: how many `verify` notices
    cost        what logging costs a message, and the loop's p99 with and without it
    verify      time a trial
    faults      each promised fault, done for real
    soak        1000 trials: memory, handles, threads, frames
    long        one trial of two hours in virtual time: the same

Prints Markdown. `--scale 0.1` does a tenth of the work.
"""

import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))
