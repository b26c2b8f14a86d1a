"""The subcommands of ``sagoma``: ``add_parser(subparsers)`` of each module adds one or more of them."""
