"""Speed against accuracy, measured on this machine: one module a trade, one page and one trade.json each."""

# Of OpenGL on processors, in the name of the renderer.
SOFTWARE_RENDERERS = ("llvmpipe", "softpipe", "swrast", "swiftshader")
