"""The registry of papers, which other packages may add to."""

from tetractl.core.registry import Registry

PAPERS = Registry(
    "tetractl.papers",
    {
        "ou": "tetractl_papers.ou:PAPER",
        "khalil-2013": "tetractl_papers.khalil_2013:PAPER",
    },
)
