"""Synthetic pictures of an emulated dish; nothing here was filmed."""
