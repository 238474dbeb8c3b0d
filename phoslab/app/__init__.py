"""The top layer: the command line, one thin module a command. It alone knows all parts."""
