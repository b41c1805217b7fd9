"""Put compiled kernels into the wheel of the core, if TETRACTL_KERNELS names their folder."""

import os
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class KernelsHook(BuildHookInterface):
    """A build hook of hatchling that adds compiled kernels to a wheel.

    A wheel with compiled code is tagged for this Python and this system.
    """

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the folder of compiled kernels to the wheel, and tag the wheel."""
        folder = os.environ.get("TETRACTL_KERNELS")
        if folder:
            build_data["force_include"][folder] = "tetractl/tools/kernels/shipped"
            build_data["pure_python"] = False
            build_data["infer_tag"] = True
