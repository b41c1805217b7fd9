"""Registries of image sources and organisms, and the folders of examples and templates."""

from pathlib import Path

from tetractl.core.registry import Registry

EXAMPLES = Path(__file__).parent / "examples"
"""The folder of the examples that `tetractl init --example` writes."""
TEMPLATES = Path(__file__).parent / "templates"
"""The folder of the templates for `tetractl init --lab --camera apriltag`."""

PICTURE_SOURCES = Registry(
    "tetractl.picture_sources",
    {
        "device": "tetractl_microscope.pictures.picture_section:DeviceSource",
        "file": "tetractl_microscope.pictures.picture_section:FileSource",
        "mjpeg": "tetractl_microscope.pictures.picture_section:MjpegSource",
        "micromanager": "tetractl_microscope.pictures.picture_section:MicroManagerSource",
    },
    "tetractl_microscope.pictures.picture_section:PictureSource",
)
ORGANISMS = Registry(
    "tetractl.organisms",
    {
        "tetrahymena": "tetractl_microscope.organisms:TETRAHYMENA",
        "paramecium": "tetractl_microscope.organisms:PARAMECIUM",
        "euglena": "tetractl_microscope.organisms:EUGLENA",
        "helical-microrobot": "tetractl_microscope.organisms:HELICAL_MICROROBOT",
        "magnetospirillum": "tetractl_microscope.organisms:MAGNETOSPIRILLUM",
    },
)
