"""GLSL sources, one file a pass; shared code in `include/`. Read by `phoslab.render.device`."""
