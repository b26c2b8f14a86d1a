"""The subcommands of ``sagoma``: each module has ``add_parser(subparsers)`` and does its work in ``run(args)``."""
