"""The node graph as data, launch files, rviz configuration."""
