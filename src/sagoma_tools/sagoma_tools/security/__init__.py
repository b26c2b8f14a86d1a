"""SROS 2: certificates and permissions for the processes of the graph."""
