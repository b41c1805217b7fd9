"""The registry of papers that can be reproduced. Other packages can add papers to it."""

from tetractl.core.registry import Registry

PAPERS = Registry(
    "tetractl.papers",
    {
        "ou": "tetractl_papers.ou:PAPER",
        "khalil-2013": "tetractl_papers.khalil_2013:PAPER",
    },
)
