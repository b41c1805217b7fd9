"""Specs are checked without compiled code or pictures: sections import those when they are used."""

import subprocess
import sys

CHECK = """
import sys
from tetractl.experiment import kinds
from tetractl.experiment.yaml.schema import experiment_schema
for registry in vars(kinds).values():
    if isinstance(registry, kinds.Registry):
        for name in registry.names():
            registry.load(name)
experiment_schema()
print(sorted({"numba", "matplotlib", "cv2", "serial"} & set(sys.modules)))
"""


def test_no_section_imports_what_is_heavy():
    done = subprocess.run([sys.executable, "-c", CHECK], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
