"""Puts compiled kernels into the wheel of the core, if TETRACTL_KERNELS names their folder."""

import os
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class KernelsHook(BuildHookInterface):
    """Called by hatchling; a wheel with compiled code is tagged for this Python and system."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the folder, and the tag."""
        folder = os.environ.get("TETRACTL_KERNELS")
        if folder:
            build_data["force_include"][folder] = "tetractl/tools/kernels/shipped"
            build_data["pure_python"], build_data["infer_tag"] = False, True
