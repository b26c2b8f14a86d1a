"""What goes wrong with a graph; a module of its own, since the rest of this package takes a second to load."""


class GraphError(RuntimeError):
    """The graph cannot run; names the failed node, its answer, and the end of its log."""
