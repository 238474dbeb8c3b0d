"""Cameras: simulated, over gphoto2, and those whose own software writes into a folder."""
