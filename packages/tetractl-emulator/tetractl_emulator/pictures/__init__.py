"""Emulated devices that show pictures or drive coils: they need the microscope's package."""
